"""Number of type errors that ty finds in the packages, against the stored one, which never rises (part of `make lint`).

After corrections store the smaller number, and after an update of ty or JAX any number:

    python tests/type_errors.py --write
"""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
STORED = ROOT / "tests" / "golden" / "type_errors.json"
CHECK = ("check", "--output-format", "concise", "--exit-zero", "--python", sys.prefix, "dropper_jax", "fitting")


def main() -> int:
    program = Path(sys.executable).with_name("ty")
    done = subprocess.run([program, *CHECK], cwd=ROOT, capture_output=True, text=True, check=True)
    errors = [line for line in done.stdout.splitlines() if ": error[" in line]
    found = Counter(Path(line.split(":")[0]).parent.as_posix() for line in errors)
    if "--write" in sys.argv:
        STORED.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n")
        return 0
    stored = json.loads(STORED.read_text())
    total, limit = found.total(), sum(stored.values())
    if total <= limit:
        print(f"{total} type errors, {limit} stored")
        return 0
    risen = [folder for folder in found if found[folder] > stored.get(folder, 0)]
    print(*(line for line in errors if Path(line.split(":")[0]).parent.as_posix() in risen), sep="\n")
    print(f"{total} type errors, {limit} stored; more than before in {', '.join(risen)}")
    return 1


if __name__ == "__main__":
    sys.exit(main())
