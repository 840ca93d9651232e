"""Rename identifiers of the whole project, as `renames.toml` lists them: python benchmarks/renames.py [--check]

It works on the syntax tree, so that text and keys of files stay: definitions by file and scope, their uses through
imports, attributes by the type of what they belong to, keywords by the function that is called. A second run changes
nothing. What it cannot decide is listed; entries whose new name is taken are refused. `--check` writes nothing.
"""

import ast
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

ROOTS = ("dropper_jax", "fitting", "tests", "benchmarks", "docs", "notebooks")
PACKAGES = ("dropper_jax", "fitting")
TEXTS = ("README.md", "CHANGELOG.md", "Makefile", "MANIFEST.in", "pyproject.toml", "mkdocs.yml")
MINE = ("benchmarks/renames.py", "benchmarks/renames.toml", "dropper_jax/base/renamed.py")  # they name old things
SEQUENCES = {
    "list",
    "Sequence",
    "Iterable",
    "Iterator",
    "set",
    "frozenset",
    "Collection",
    "Generator",
    "MutableSequence",
}
SAME = {"replace", "copy", "deepcopy", "vmap", "jit", "partial", "stop_gradient", "block_until_ready", "wraps"}
ELEMENTS = {"list", "tuple", "sorted", "reversed", "set", "frozenset", "iter", "filter"}
BY_NAME = {"getattr", "hasattr", "setattr", "delattr"}  # calls whose second argument is the name of an attribute
LITERAL = re.compile(r"(?i)([rbuf]{0,2})('''|\"\"\"|'|\")")
END = re.compile(r"[}:]|!(?!=)|=\s*[!:}]")  # of an expression in an f-string


# ---------------------------------------------------------------- source text and positions


def f_string_parts(text, start, end):
    """Where the expressions of an f-string stand, in the order of its syntax tree (3.11 has no positions of them)."""
    parts = []

    def expression(i, quote):
        first, depth, inner = i, 0, ""
        while True:
            c = text[i]
            if inner:
                inner = "" if c == inner else inner
            elif c in "'\"" and not text.startswith(quote, i):
                inner = c
            elif c in "([{":
                depth += 1
            elif c in ")]" or (c == "}" and depth):
                depth -= 1
            elif depth == 0 and END.match(text, i):
                break
            i += 1
        parts.append((first, i))
        while text[i] not in ":}":
            i += 1
        if text[i] == ":":
            i += 1
            while text[i] != "}":
                i = expression(i + 1, quote) if text[i] == "{" else i + 1
        return i + 1

    i = start
    while i < end:
        match = LITERAL.match(text, i)
        if match is None:
            i = text.index("\n", i) if text[i] == "#" else i + 1
            continue
        kind, quote = match[1].lower(), match[2]
        i = match.end()
        while not text.startswith(quote, i):
            escaped = text[i] == "\\" and "r" not in kind
            if escaped or ("f" in kind and text[i] in "{}" and text[i + 1] == text[i]):
                i += 2
            elif "f" in kind and text[i] == "{":
                i = expression(i + 1, quote)
            else:
                i += 1
        i += len(quote)
    return parts


def located(text, base=0, mode="exec"):
    """The syntax tree of a text, every node with `at` and `end`, characters from the start of the file."""
    tree = ast.parse(text, mode=mode)
    lines = text.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def offset(line, column):
        row = lines[line - 1] if line <= len(lines) else ""
        return starts[line - 1] + (column if row.isascii() else len(row.encode()[:column].decode()))

    def visit(node):
        if hasattr(node, "lineno"):
            node.at, node.end = (
                base + offset(node.lineno, node.col_offset),
                base + offset(node.end_lineno, node.end_col_offset),
            )
        if isinstance(node, ast.JoinedStr):
            parts = iter(f_string_parts(text, node.at - base, node.end - base))
            fill(node, parts)
            return
        for child in ast.iter_child_nodes(node):
            visit(child)

    def fill(joined, parts):
        for value in joined.values:
            if isinstance(value, ast.FormattedValue):
                first, last = next(parts)
                value.value = located(f"({text[first:last]})", base + first - 1, "eval").body
                if value.format_spec is not None:
                    fill(value.format_spec, parts)

    visit(tree)
    return tree


# ---------------------------------------------------------------- scopes


class Scope:
    """A module, class, function, lambda or comprehension, and where its names occur."""

    def __init__(self, kind, node, parent, source, name=""):
        self.kind, self.node, self.parent, self.source, self.name = kind, node, parent, source, name
        self.bound, self.refs, self.values, self.outer = {}, defaultdict(list), defaultdict(list), set()
        self.children = []
        if parent is not None:
            parent.children.append(self)

    @property
    def path(self):
        words, scope = [], self
        while scope.kind != "module":
            if scope.name:
                words.append(scope.name)
            scope = scope.parent
        return ".".join(reversed(words))

    def bind(self, name, how):
        if name in self.outer:
            return self.parent.bind(name, how)
        self.bound.setdefault(name, set()).add(how)
        return self

    def find(self, name):
        scope, first = self, True
        while scope is not None:
            if name in scope.bound and (first or scope.kind != "class"):
                return scope
            first = first and scope.kind == "comprehension" and scope.parent.kind == "class"
            scope = scope.parent
        return None

    def below(self):
        yield self
        for child in self.children:
            yield from child.below()


class Source:
    """A file (or a block of Python in a page), its tree, scopes and edits."""

    def __init__(self, path, text, base=0):
        self.path, self.text, self.edits = path, text, {}
        self.module = path.removesuffix(".py").removesuffix(".pyi").removesuffix("/__init__").replace("/", ".")
        self.package = path.endswith(("__init__.py", "__init__.pyi"))
        self.tree = located(text)
        self.top = Scope("module", self.tree, None, self)
        self.attributes, self.calls, self.imports, self.modules, self.scope_of = [], [], [], [], {}
        self._uses = []
        for statement in self.tree.body:
            self._visit(statement, self.top)
        for at, name, scope in self._uses:
            home = scope.find(name)
            if home is not None:
                home.refs[name].append((at, scope))

    def edit(self, at, old, new):
        assert self.text[at : at + len(old)] == old, (self.path, self.text[at - 30 : at + 30], old)
        if self.edits.get(at, (old, new)) != (old, new):
            raise SystemExit(f"{self.path}: {old!r} at {at}: two new names {self.edits[at][1]!r}, {new!r}")
        self.edits[at] = (old, new)

    def result(self):
        text = self.text
        for at in sorted(self.edits, reverse=True):
            old, new = self.edits[at]
            text = text[:at] + new + text[at + len(old) :]
        return text

    def _use(self, at, name, scope):
        self._uses.append((at, name, scope))

    def _store(self, target, scope, value):
        """Bind the names of a target; `value` is (how, expression) that tells their type."""
        if isinstance(target, ast.Name):
            holder = scope
            scope.bind(target.id, "variable")
            holder.values[target.id].append((*value, scope))
        elif isinstance(target, (ast.Tuple, ast.List)):
            for i, item in enumerate(target.elts):
                star = isinstance(item, ast.Starred)
                self._store(item.value if star else item, scope, ("none" if star else "item", (value, i)))

    def _visit(self, node, scope):
        self.scope_of[node] = scope
        method = getattr(self, f"_{type(node).__name__}", None)
        if method is not None:
            method(node, scope)
        else:
            for child in ast.iter_child_nodes(node):
                self._visit(child, scope)

    def _function(self, node, scope):
        self._list(node.decorator_list, scope)
        name_at = self.text.index(node.name, self.text.index("def ", node.at) + 4)
        node.name_at = name_at
        scope.bind(node.name, "function")
        scope.values[node.name].append(("def", node, scope))
        self._use(name_at, node.name, scope)
        inner = Scope("function", node, scope, self, node.name)
        self._arguments(node.args, scope, inner)
        if node.returns is not None:
            self._visit(node.returns, scope)
        self._list(node.body, inner)

    _FunctionDef = _AsyncFunctionDef = _function

    def _arguments(self, args, scope, inner):
        for arg in (*args.posonlyargs, *args.args, *args.kwonlyargs, args.vararg, args.kwarg):
            if arg is not None:
                inner.bind(arg.arg, "argument")
                how = "annotation" if arg.annotation is not None else "argument"
                if arg is args.vararg:
                    how = "each"
                inner.values[arg.arg].append((how, arg.annotation, scope))
                self._use(arg.at, arg.arg, inner)
                if arg.annotation is not None:
                    self._visit(arg.annotation, scope)
        self._list([d for d in (*args.defaults, *args.kw_defaults) if d is not None], scope)

    def _Lambda(self, node, scope):
        inner = Scope("function", node, scope, self)
        self._arguments(node.args, scope, inner)
        self._visit(node.body, inner)

    def _ClassDef(self, node, scope):
        self._list(node.decorator_list, scope)
        node.name_at = self.text.index(node.name, self.text.index("class ", node.at) + 6)
        scope.bind(node.name, "class")
        scope.values[node.name].append(("class", node, scope))
        self._use(node.name_at, node.name, scope)
        self._list(node.bases, scope)
        for keyword in node.keywords:
            self._visit(keyword.value, scope)
        inner = Scope("class", node, scope, self, node.name)
        node.scope = inner
        self._list(node.body, inner)

    def _comprehension(self, node, scope):
        inner = Scope("comprehension", node, scope, self)
        for i, generator in enumerate(node.generators):
            self._visit(generator.iter, inner if i else scope)
            self._store(generator.target, inner, ("each-of", generator.iter))
            self._visit(generator.target, inner)
            self._list(generator.ifs, inner)
        for field in ("elt", "key", "value"):
            if hasattr(node, field):
                self._visit(getattr(node, field), inner)

    _ListComp = _SetComp = _DictComp = _GeneratorExp = _comprehension

    def _list(self, nodes, scope):
        for node in nodes:
            self._visit(node, scope)

    def _Name(self, node, scope):
        if isinstance(node.ctx, ast.Del):
            scope.bind(node.id, "variable")
        self._use(node.at, node.id, scope)

    def _Assign(self, node, scope):
        for target in node.targets:
            self._store(target, scope, ("value", node.value))
            self._visit(target, scope)
        self._visit(node.value, scope)

    def _AnnAssign(self, node, scope):
        self._store(node.target, scope, ("annotation", node.annotation))
        self._visit(node.target, scope)
        self._visit(node.annotation, scope)
        if node.value is not None:
            self._visit(node.value, scope)

    def _AugAssign(self, node, scope):
        self._store(node.target, scope, ("value", node.value))
        self._visit(node.target, scope)
        self._visit(node.value, scope)

    def _NamedExpr(self, node, scope):
        holder = scope
        while holder.kind == "comprehension":
            holder = holder.parent
        self._store(node.target, holder, ("value", node.value))
        self._visit(node.target, scope)
        self._visit(node.value, scope)

    def _For(self, node, scope):
        self._store(node.target, scope, ("each-of", node.iter))
        for child in ast.iter_child_nodes(node):
            self._visit(child, scope)

    def _withitem(self, node, scope):
        self._visit(node.context_expr, scope)
        if node.optional_vars is not None:
            self._store(node.optional_vars, scope, ("value", node.context_expr))
            self._visit(node.optional_vars, scope)

    def _ExceptHandler(self, node, scope):
        if node.type is not None:
            self._visit(node.type, scope)
        if node.name:
            scope.bind(node.name, "variable")
            self._use(self.text.index(node.name, self.text.index(" as ", node.type.end) + 4), node.name, scope)
        self._list(node.body, scope)

    def _Nonlocal(self, node, scope):
        at = node.at + len("nonlocal")
        for name in node.names:
            scope.outer.add(name)
            at = re.compile(rf"\b{name}\b").search(self.text, at).start()
            self._use(at, name, scope)

    def _Global(self, node, scope):
        at = node.at + len("global")
        for name in node.names:
            at = re.compile(rf"\b{name}\b").search(self.text, at).start()
            self._use(at, name, scope)

    def _Import(self, node, scope):
        for alias in node.names:
            name = alias.asname or alias.name.split(".")[0]
            scope.bind(name, "import")
            scope.values[name].append(("module", alias.name if alias.asname else alias.name.split(".")[0], scope))
            self.modules.append((alias.at, alias.name))
            if alias.asname:
                self._use(alias.end - len(alias.asname), alias.asname, scope)

    def _ImportFrom(self, node, scope):
        home = node.module or ""
        if node.level:
            words = self.module.split(".")
            words = words[: len(words) - node.level + (1 if self.package else 0)]
            home = ".".join([*words, *([node.module] if node.module else [])])
        elif node.module:
            self.modules.append((self.text.index(node.module, node.at + 4), node.module))
        for alias in node.names:
            name = alias.asname or alias.name
            scope.bind(name, "import")
            scope.values[name].append(("from", (home, alias.name), scope))
            self.imports.append((alias, home, scope))
            if alias.asname:
                self._use(alias.end - len(alias.asname), alias.asname, scope)

    def _Attribute(self, node, scope):
        self.attributes.append((node, scope))
        self._visit(node.value, scope)

    def _Call(self, node, scope):
        self.calls.append((node, scope))
        self._visit(node.func, scope)
        self._list(node.args, scope)
        for keyword in node.keywords:
            self._visit(keyword.value, scope)

    def _MatchAs(self, node, scope):
        if node.pattern is not None:
            self._visit(node.pattern, scope)
        if node.name:
            scope.bind(node.name, "variable")
            self._use(node.end - len(node.name), node.name, scope)


# ---------------------------------------------------------------- types


class Class:
    """A class of the project: its members and bases."""

    def __init__(self, node, source):
        self.node, self.source, self.scope = node, source, node.scope
        self.members = {n for n, how in node.scope.bound.items() if how & {"variable", "function"}}
        self.assigned = defaultdict(list)  # self.x = value
        for scope in node.scope.children:
            if scope.kind == "function" and isinstance(scope.node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                own = [a.arg for a in scope.node.args.args[:1]]
                for n in ast.walk(scope.node):
                    stored = isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)
                    if stored and isinstance(n.value, ast.Name) and own == [n.value.id]:
                        self.assigned[n.attr].append((scope, n))
        self.members |= set(self.assigned)

    @property
    def key(self):
        return f"{self.source.path}::{self.scope.path}"


class Project:
    """All sources, and the types of expressions in them as far as annotations and assignments tell."""

    def __init__(self, sources):
        self.sources, self.depth, self.cache, self.alive = sources, 0, {}, []
        self.noted, self.parsed = {}, {}
        self.by_module = {}
        for source in sources:
            if source.path.endswith(".py") and "#" not in source.path:
                self.by_module[source.module] = source
        self.stub = next((s for s in sources if s.path == "dropper_jax/__init__.pyi"), None)
        self.classes = {}
        for source in sources:
            for scope in source.top.below():
                if scope.kind == "class":
                    self.classes[scope.node] = Class(scope.node, source)
        self.subclasses = defaultdict(list)
        self._bases = {}
        for cls in self.classes.values():
            for base in self.bases(cls):
                self.subclasses[base].append(cls)
        self.owners = defaultdict(list)
        for cls in self.classes.values():
            for name in cls.members:
                self.owners[name].append(cls)

    def bases(self, cls):
        if cls not in self._bases:
            self._bases[cls] = []
            found = []
            for base in cls.node.bases:
                base = base.value if isinstance(base, ast.Subscript) else base
                found += [t[1] for t in self.infer(base, cls.source, cls.scope.parent) if t[0] == "class"]
            self._bases[cls] = found
        return self._bases[cls]

    def lineage(self, cls):
        found, todo = [], [cls]
        while todo:
            one = todo.pop(0)
            if one not in found:
                found.append(one)
                todo += self.bases(one)
        return found

    def family(self, cls, member):
        """All classes of the project that share a member with this one by inheritance."""
        found, todo = set(), [cls]
        while todo:
            one = todo.pop()
            if one not in found:
                found.add(one)
                todo += [c for c in self.lineage(one)[1:] if self.has(c, member)]
                todo += self.subclasses[one]
        return {c for c in found if member in c.members}

    def has(self, cls, member):
        return any(member in c.members for c in self.lineage(cls))

    def depth_of(self, cls):
        return len(self.lineage(cls))

    def module_member(self, module, name, seen=()):
        """(source, scope name) where a name that is imported from a module is defined; or a module."""
        if (module, name) in seen:
            return None
        if f"{module}.{name}" in self.by_module:
            source = self.by_module.get(module)
            if source is None or name not in source.top.bound or source.top.bound[name] == {"import"}:
                return ("module", self.by_module[f"{module}.{name}"])
        source = self.by_module.get(module)
        if module == "dropper_jax" and self.stub is not None and name in self.stub.top.bound:
            source = self.stub
        if source is None or name not in source.top.bound:
            return None
        for how, what, _ in source.top.values[name]:
            if how == "from":
                return self.module_member(*what, (*seen, (module, name)))
        return ("name", source, name)

    def infer(self, node, source, scope):
        """Types of an expression: a list of ("inst" | "class", Class), ("func", node, Source, Class | None), ..."""
        key = (id(node), id(scope))
        if key in self.cache:
            return self.cache[key]
        if self.depth > 25:
            return []
        self.depth += 1
        self.cache[key] = []
        self.alive.append(node)  # an `id` is one only as long as its node is there
        try:
            found = distinct(self._infer(node, source, scope))
        finally:
            self.depth -= 1
        self.cache[key] = found
        return found

    def _infer(self, node, source, scope):
        if isinstance(node, ast.Name):
            return self._name(node.id, source, scope)
        if isinstance(node, ast.Attribute):
            return self._attribute(node, source, scope)
        if isinstance(node, ast.Call):
            return self._call(node, source, scope)
        if isinstance(node, ast.Subscript):
            found = []
            for t in self.infer(node.value, source, scope):
                if t[0] == "seq":
                    found += [t] if isinstance(node.slice, ast.Slice) else t[1]
                elif t[0] == "tuple":
                    index = node.slice.value if isinstance(node.slice, ast.Constant) else None
                    if isinstance(index, int) and -len(t[1]) <= index < len(t[1]):
                        found += t[1][index]
                elif t[0] == "dict":
                    found += t[1]
                elif t[0] == "class":
                    found.append(t)
            return found
        if isinstance(node, ast.IfExp):
            return self.infer(node.body, source, scope) + self.infer(node.orelse, source, scope)
        if isinstance(node, ast.BoolOp):
            return [t for value in node.values for t in self.infer(value, source, scope)]
        if isinstance(node, (ast.NamedExpr, ast.Await, ast.Starred)):
            return self.infer(node.value, source, scope)
        if isinstance(node, (ast.Tuple)):
            return [("tuple", [self.infer(e, source, scope) for e in node.elts])]
        if isinstance(node, (ast.List, ast.Set)):
            return [("seq", [t for e in node.elts for t in self.infer(e, source, scope)])]
        if isinstance(node, ast.Dict):
            return [("dict", [t for e in node.values for t in self.infer(e, source, scope)])]
        if isinstance(node, (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp)):
            inner = (
                next(c for c in scope.children if c.node is node)
                if any(c.node is node for c in scope.children)
                else None
            )
            if inner is None:
                return []
            if isinstance(node, ast.DictComp):
                return [("dict", self.infer(node.value, source, inner))]
            return [("seq", self.infer(node.elt, source, inner))]
        if isinstance(node, ast.Lambda):
            inner = next((c for c in scope.children if c.node is node), None)
            return [] if inner is None else [("call", self.infer(node.body, source, inner))]
        return []

    def _name(self, name, source, scope):
        home = scope.find(name)
        if home is None:
            return []
        found = []
        for how, what, where in home.values.get(name, ()):
            found += self._value(how, what, home.source, where, home, name)
        return found

    def _value(self, how, what, source, where, home, name):
        if how == "def":
            owner = self.classes.get(home.node) if home.kind == "class" else None
            return [("func", what, source, owner)]
        if how == "class":
            return [("class", self.classes[what])]
        if how == "annotation":
            return self.annotation(what, source, where)
        if how == "each":
            return [("seq", self.annotation(what, source, where) if what is not None else [])]
        if how == "argument":
            if home.parent.kind == "class" and name in ("self", "cls"):
                return [("class" if name == "cls" else "inst", self.classes[home.parent.node])]
            return self._fixture(name, source)
        if how == "value":
            return self.infer(what, source, where)
        if how == "each-of":
            return self._elements(self.infer(what, source, where))
        if how == "item":
            (inner, expression), i = what[0][:2], what[1]
            found = []
            for t in self._value(inner, expression, source, where, home, name):
                if t[0] == "tuple" and i < len(t[1]):
                    found += t[1][i]
                elif t[0] == "seq":
                    found += t[1]
                elif t[0] == "inst":
                    fields = [n.target.id for n in t[1].node.body if isinstance(n, ast.AnnAssign)]
                    if i < len(fields):
                        found += self.member(t[1], fields[i])
            return found
        if how == "module":
            return [("mod", self.by_module[what])] if what in self.by_module else [("outside", what)]
        if how == "from":
            member = self.module_member(*what)
            if member is None:
                inside = what[0].split(".")[0] in PACKAGES
                return [] if inside else [("outside", what[0])]
            if member[0] == "module":
                return [("mod", member[1])]
            return self._name(member[2], member[1], member[1].top)
        return []

    def _fixture(self, name, source):
        if not source.path.startswith("tests/"):
            return []
        folder, homes = Path(source.path).parent, [source]
        while str(folder) not in (".", ""):
            homes += [s for s in self.sources if s.path == f"{folder}/conftest.py"]
            folder = folder.parent
        for home in homes:
            for how, what, _ in home.top.values.get(name, ()):
                if how == "def":
                    return self.returns(what, home, None)
        return []

    def _elements(self, types):
        found = []
        for t in types:
            if t[0] == "seq":
                found += t[1]
            elif t[0] == "tuple":
                found += [u for item in t[1] for u in item]
            elif t[0] == "inst":
                found += [
                    u
                    for f in self.member(t[1], "__iter__")
                    if f[0] == "func"
                    for u in self._elements(self.returns(*f[1:]))
                ]
        return found

    def returns(self, node, source, owner):
        if node.returns is not None:
            where = source.scope_of[node]
            text = ast.unparse(node.returns)
            if text.strip("\"'") == "Self" and owner is not None:
                return [("inst", owner)]
            return self.annotation(node.returns, source, where)
        scope = next((s for s in source.scope_of[node].children if s.node is node), None)
        found = []
        for n in ast.walk(node):
            if isinstance(n, (ast.Return, ast.Yield)) and n.value is not None and scope is not None:
                found += self.infer(n.value, source, source.scope_of.get(n.value, scope))
        return found

    def annotation(self, node, source, scope):
        if isinstance(node, ast.Constant):
            if not isinstance(node.value, str):
                return []
            if node not in self.parsed:
                try:
                    self.parsed[node] = ast.parse(node.value, mode="eval").body
                except SyntaxError:
                    self.parsed[node] = None
            return [] if self.parsed[node] is None else self.annotation(self.parsed[node], source, scope)
        key = (node, scope)
        if key not in self.noted:
            self.noted[key] = []
            self.noted[key] = distinct(self._annotation(node, source, scope))
        return self.noted[key]

    def _annotation(self, node, source, scope):
        if isinstance(node, ast.BinOp):
            return self.annotation(node.left, source, scope) + self.annotation(node.right, source, scope)
        if isinstance(node, ast.Subscript):
            base = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
            inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            if base == "tuple" and len(inner) == 2 and isinstance(inner[1], ast.Constant) and inner[1].value is ...:
                return [("seq", self.annotation(inner[0], source, scope))]
            if base == "tuple":
                return [("tuple", [self.annotation(e, source, scope) for e in inner])]
            if base in SEQUENCES:
                return [("seq", self.annotation(inner[0], source, scope))]
            if base in ("dict", "Mapping", "MutableMapping", "defaultdict"):
                return [("dict", self.annotation(inner[1], source, scope))]
            if base == "Callable":
                return [("call", self.annotation(inner[-1], source, scope))]
            if base == "type":
                return [("class", t[1]) for t in self.annotation(inner[0], source, scope) if t[0] == "inst"]
            if base in ("ClassVar", "Final", "Optional", "Annotated"):
                return self.annotation(inner[0], source, scope)
            return self.annotation(node.value, source, scope)
        found = []
        for t in self.infer(node, source, scope):
            found.append(("inst", t[1]) if t[0] == "class" else t)
        if isinstance(node, ast.Name) and not any(t[0] == "inst" for t in found):  # an alias, or a type variable
            home = scope.find(node.id)
            for how, what, where in home.values.get(node.id, ()) if home is not None else ():
                if how == "value" and isinstance(what, ast.Call) and getattr(what.func, "id", "") == "TypeVar":
                    for k in what.keywords:
                        if k.arg == "bound":
                            found += self.annotation(k.value, source, where)
                    for a in what.args[1:]:
                        found += self.annotation(a, source, where)
                elif how in ("value", "annotation") and not isinstance(what, ast.Name):
                    found += self.annotation(what, source, where) if how == "value" else []
                elif how == "from":
                    member = self.module_member(*what)
                    if member is not None and member[0] == "name" and not found:
                        alias = self.parsed.setdefault((member[1], member[2]), ast.Name(member[2]))
                        found += self.annotation(alias, member[1], member[1].top)
        return found

    def member(self, cls, name):
        """Types of an attribute of instances of a class."""
        for one in self.lineage(cls):
            if name not in one.members:
                continue
            found = []
            for how, what, where in one.scope.values.get(name, ()):
                if how == "def":
                    words = {ast.unparse(d).split("(")[0].split(".")[-1] for d in what.decorator_list}
                    if words & {"property", "cached_property"}:
                        found += self.returns(what, one.source, cls)
                    else:
                        found.append(("func", what, one.source, cls))
                else:
                    found += self._value(how, what, one.source, where, one.scope, name)
            for scope, target in one.assigned.get(name, ()):
                found += self._assigned(one.source, scope, target)
            if found or name in one.scope.bound:
                return found
        return []

    def _assigned(self, source, scope, target):
        for n in ast.walk(scope.node):
            if isinstance(n, ast.Assign) and target in n.targets:
                return self.infer(n.value, source, scope)
            if isinstance(n, ast.AnnAssign) and n.target is target:
                return self.annotation(n.annotation, source, scope)
            if isinstance(n, ast.Assign):
                for t in n.targets:
                    if isinstance(t, ast.Tuple) and target in t.elts:
                        return self._value("item", (("value", n.value), t.elts.index(target)), source, scope, scope, "")
        return []

    def _attribute(self, node, source, scope):
        found = []
        for t in self.infer(node.value, source, scope):
            if t[0] in ("inst", "class"):
                found += self.member(t[1], node.attr)
            elif t[0] == "mod":
                member = self.module_member(t[1].module, node.attr)
                if member is not None:
                    found += (
                        [("mod", member[1])]
                        if member[0] == "module"
                        else self._name(member[2], member[1], member[1].top)
                    )
            elif t[0] == "outside":
                found.append(t)
            elif t[0] == "dict" and node.attr in ("items", "values", "get", "pop", "setdefault"):
                inner = {"items": [("seq", [("tuple", [[], t[1]])])], "values": [("seq", t[1])]}.get(node.attr, t[1])
                found.append(("call", inner))
            elif t[0] == "seq" and node.attr == "pop":
                found.append(("call", t[1]))
        if node.attr == "_replace":
            found += [("call", [t]) for t in self.infer(node.value, source, scope) if t[0] == "inst"]
        return found

    def _call(self, node, source, scope):
        word = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        types = self.infer(node.func, source, scope)
        known = [t for t in types if t[0] in ("class", "func", "call")]
        if not known or all(t[0] == "outside" for t in types):
            first = self.infer(node.args[0], source, scope) if node.args else []
            if word in SAME:
                return first
            if word in ELEMENTS:
                return [("seq", self._elements(first))]
            if word == "next":
                return self._elements(first)
            if word == "enumerate":
                return [("seq", [("tuple", [[], self._elements(first)])])]
            if word == "zip":
                return [("seq", [("tuple", [self._elements(self.infer(a, source, scope)) for a in node.args])])]
            if word == "map" and node.args:
                return [("seq", self._result(first, node))]
            if word in ("max", "min"):
                return self._elements(first) if len(node.args) == 1 else first
            if word == "super":
                home = scope
                while home is not None and home.kind != "class":
                    home = home.parent
                return [("inst", b) for b in self.bases(self.classes[home.node])] if home is not None else []
        return self._result(known, node)

    def _result(self, types, node):
        found = []
        for t in types:
            if t[0] == "class":
                found.append(("inst", t[1]))
            elif t[0] == "func":
                found += self.returns(t[1], t[2], t[3])
            elif t[0] == "call":
                found += t[1]
        return found


# ---------------------------------------------------------------- renaming


class Renames:
    """What the map says of one state of the project."""

    def __init__(self, table, project):
        self.table, self.project = table, project
        self.paths = table["modules"]
        self.dotted = {dotted(a): dotted(b) for a, b in self.paths.items()}
        self.names, self.members = {}, {}  # (Scope, name) -> new; (Class, name) -> new
        self.given = defaultdict(set)  # new names of a scope
        self.by_argument = defaultdict(set)  # argument name -> its new names over all functions
        self.refused, self.undecided, self.assumed, self.left = [], [], [], []
        self._definitions()
        self._locals()
        self._check()

    # what is renamed

    def _definitions(self):
        by_path = {s.path: s for s in self.project.sources}
        for key, new in self.table["definitions"].items():
            path, _, inner = key.partition("::")
            source = by_path.get(path) or by_path.get(self.paths.get(path, ""))
            if source is None:
                continue
            for scope in list(source.top.below()):
                words = inner.split(".")
                if (
                    scope.path != ".".join(words[:-1])
                    or scope.kind == "comprehension"
                    or (scope.kind != "module" and not scope.name)
                ):
                    continue
                old = words[-1]
                if scope.kind == "class":
                    cls = self.project.classes[scope.node]
                    if old in cls.members:
                        self._member(cls, old, new)
                elif old in scope.bound:
                    self.names[scope, old] = new
                    self.given[scope].add(new)
        for name, new in self.table["members"].items():
            for cls in self.project.owners.get(name, ()):
                if cls.source.path.startswith(PACKAGES) and f"{cls.key}.{name}" not in self.table["keep"]:
                    self._member(cls, name, new, soft=True)

    def _member(self, cls, old, new, soft=False):
        family = self.project.family(cls, old)
        for one in family:
            before = self.members.get((one, old))
            if before is not None and before != new and not soft:
                self.refused.append(f"{one.key}.{old}: both {before} and {new}")
            if before is None or not soft:
                self.members[one, old] = new
            if any(new in c.members for c in self.project.lineage(one)):
                self.refused.append(f"{one.key}: {old} -> {new}: it has such a member")

    def _locals(self):
        rules = self.table["locals"]
        special = {}
        for key, words in self.table["arguments"].items():
            path, _, inner = key.partition("::")
            special[path, inner] = words
            special[self.paths.get(path, path), inner] = words
        for source in self.project.sources:
            if not source.path.startswith(PACKAGES):
                continue
            everywhere = {}
            for (path, inner), words in special.items():
                if not inner and (source.path == path or (path.endswith("/") and source.path.startswith(path))):
                    everywhere = everywhere | words
            for scope in source.top.below():
                if scope.kind not in ("function", "comprehension"):
                    continue
                mine = everywhere | special.get((source.path, scope.path), {})
                for name, how in scope.bound.items():
                    if how & {"import", "function", "class"} or (scope, name) in self.names:
                        continue
                    wanted = mine.get(name, rules.get(name, ()))
                    wanted = [wanted] if isinstance(wanted, str) else wanted
                    if not wanted or wanted == [name]:
                        continue
                    new = next((w for w in wanted if not self._taken(scope, name, w)), None)
                    if new is None:
                        self.left.append(f"{source.path}::{scope.path}: {name}: {', '.join(wanted)} taken")
                    else:
                        self.names[scope, name] = new
                        self.given[scope].add(new)
        for source in self.project.sources:
            for node, scope in (
                (n, s) for n, s in source.scope_of.items() if isinstance(n, (ast.FunctionDef, ast.Lambda))
            ):
                inner = next((c for c in scope.children if c.node is node), None)
                for arg in arguments(node) if inner is not None else ():
                    self.by_argument[arg].add(self.names.get((inner, arg), arg))
        for cls in self.project.classes.values():
            for name in cls.members & set(cls.scope.bound):
                if "variable" in cls.scope.bound[name]:
                    self.by_argument[name].add(self.members.get((cls, name), name))

    def _taken(self, scope, old, new):
        """Whether a new name of a scope would meet another one: there, or where the old one is used."""
        if new in scope.bound or new in BUILTINS or new in self.given[scope]:
            return True
        for _, where in scope.refs[old]:
            while where is not scope:
                if new in where.bound or new in self.given[where]:
                    return True
                where = where.parent
        outer = scope.parent  # what is used below under the new name, from further out
        while outer is not None:
            for name in (new, *(n for n in outer.bound if self.names.get((outer, n)) == new)):
                if any(inside(where, scope) for _, where in outer.refs.get(name, ())):
                    return True
            outer = outer.parent
        return False

    def _check(self):
        for (scope, old), new in self.names.items():
            if new in scope.bound:
                self.refused.append(f"{scope.source.path}::{scope.path}: {old} -> {new}: it is there")
            for _, where in scope.refs[old]:
                while where is not None and where is not scope:
                    if new in where.bound and self.names.get((where, new)) is None:
                        self.refused.append(
                            f"{scope.source.path}::{where.path}: {old} -> {new}: hidden by another {new}"
                        )
                        break
                    if any(self.names.get((where, n)) == new for n in where.bound):
                        self.refused.append(
                            f"{scope.source.path}::{where.path}: {old} -> {new}: hidden by another {new}"
                        )
                        break
                    where = where.parent

    # uses

    def of_member(self, cls, name):
        """(known, new name) of an attribute of a class."""
        for one in self.project.lineage(cls):
            if (one, name) in self.members:
                return True, self.members[one, name]
            if name in one.members:
                return True, name
        below = [c for c in self.project.owners.get(name, ()) if cls in self.project.lineage(c)]
        news = {self.members.get((c, name), name) for c in below}
        return (True, news.pop()) if len(news) == 1 else (False, name)

    def of_types(self, types, name):
        """(known, new name) of an attribute of something of these types."""
        news = set()
        for t in types:
            if t[0] in ("inst", "class"):
                known, new = self.of_member(t[1], name)
                if known:
                    news.add(new)
            elif t[0] == "mod":
                new = self.of_module(t[1].module, name)
                news.add(new)
            elif t[0] == "outside" and len(types) == 1:
                news.add(name)
        return (True, news.pop()) if len(news) == 1 else (False, name)

    def of_module(self, module, name):
        if f"{module}.{name}" in self.dotted:
            return self.dotted[f"{module}.{name}"].rpartition(".")[2]
        member = self.project.module_member(module, name)
        if member is None or member[0] == "module":
            return name
        return self.names.get((member[1].top, member[2]), name)

    def attribute(self, source, scope, value, name, at, write):
        """Rename the use of an attribute at a position, where its owner is known or all owners agree."""
        owners = self.project.owners.get(name, ())
        news = {self.members.get((c, name), name) for c in owners}
        types = self.project.infer(value, source, scope)
        known, new = self.of_types(types, name)
        if not known:
            if news <= {name}:
                return
            for pattern, hint in self.table["receivers"].get(name, ()):
                if re.search(pattern, f"{source.path}::{scope.path}::{ast.unparse(value)}"):
                    known, new = True, hint
                    break
        if not known:
            where = f"{source.path}:{source.text.count(chr(10), 0, at) + 1}: {ast.unparse(value)}.{name}"
            if len(news) > 1:
                self.undecided.append(f"{where}: {', '.join(sorted(news))}")
                return
            new = next(iter(news))
            self.assumed.append(f"{where} -> {new}")
        if new != name:
            write(at, name, new)

    def keyword(self, source, scope, call, keyword):
        name, news = keyword.arg, set()
        word = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        if word == "SimpleNamespace":  # something that a test makes instead of an object of a class
            self._fake(source, scope, call, keyword)
            return
        if self.by_argument.get(name, {name}) <= {name} or word == "dict":
            return
        types = self.project.infer(call.func, source, scope)
        if word in ("replace", "_replace", "partial", "evolve") and (call.args or word == "_replace"):
            what = call.func.value if word == "_replace" else call.args[0]
            inner = self.project.infer(what, source, scope)
            if word == "partial":
                types = inner
            else:
                known, new = self.of_types(inner, name)
                news |= {new} if known else set()
                types = []
        unknown = False
        for t in types:
            if t[0] == "class":
                maker = self.project.member(t[1], "__init__")
                if maker:
                    news |= {self.of_function(f, name) for f in maker if f[0] == "func"}
                else:
                    known, new = self.of_member(t[1], name)
                    news |= {new} if known else set()
            elif t[0] == "func":
                news.add(self.of_function(t, name))
            elif t[0] == "outside":
                news.add(name)
            else:
                unknown = True
        if not news or (unknown and len(news) > 1):
            news = set(self.by_argument[name])
            where = f"{source.path}:{source.text.count(chr(10), 0, keyword.at) + 1}: {ast.unparse(call.func)}({name}=)"
            for pattern, hint in self.table["receivers"].get(f"{name}=", ()):
                if re.search(pattern, f"{source.path}::{scope.path}::{ast.unparse(call.func)}"):
                    news = {hint}
                    break
            else:
                if len(news) == 1:
                    self.assumed.append(f"{where} -> {next(iter(news))}")
                else:
                    self.undecided.append(f"{where}: {', '.join(sorted(news))}")
                    return
        if len(news) == 1 and next(iter(news)) != name:
            source.edit(keyword.at, name, news.pop())

    def _fake(self, source, scope, call, keyword):
        name = keyword.arg
        news = {self.members.get((c, name), name) for c in self.project.owners.get(name, ())}
        if news <= {name}:
            return
        for pattern, hint in self.table["receivers"].get(f"{name}=", ()):
            if re.search(pattern, f"{source.path}::{scope.path}::{ast.unparse(call.func)}"):
                news = {hint}
                break
        if len(news) > 1:
            where = f"{source.path}:{source.text.count(chr(10), 0, keyword.at) + 1}"
            self.undecided.append(f"{where}: SimpleNamespace({name}=): {', '.join(sorted(news))}")
        elif news != {name}:
            source.edit(keyword.at, name, news.pop())

    def of_function(self, t, name):
        _, node, source, _ = t
        inner = next((c for c in source.scope_of[node].children if c.node is node), None)
        if inner is None or name not in arguments(node):
            return name
        return self.names.get((inner, name), name)

    def rewrite(self, source):
        """All edits of a file."""
        for scope in source.top.below():
            for name in scope.bound:
                new = self.names.get((scope, name))
                if scope.kind == "class":
                    new = self.members.get((self.project.classes[scope.node], name), new)
                if new is None:
                    new = self._imported(source, scope, name)
                if new is not None and new != name:
                    for at, _ in scope.refs[name]:
                        source.edit(at, name, new)
        for alias, home, _ in source.imports:
            new = self.of_module(home, alias.name)
            if new != alias.name:
                source.edit(alias.at, alias.name, new)
        for at, module in source.modules:
            for old, new in self.dotted.items():
                if module == old or module.startswith(old + "."):
                    source.edit(at, module, new + module[len(old) :])
        for node, scope in source.attributes:
            self.attribute(source, scope, node.value, node.attr, node.end - len(node.attr), source.edit)
        for call, scope in source.calls:
            for keyword in call.keywords:
                if keyword.arg is not None:
                    self.keyword(source, scope, call, keyword)
            self._strings_of(source, scope, call)
        self._text(source)

    def _imported(self, source, scope, name):
        """The new name of what an import binds under the name it had."""
        for how, what, _ in scope.values.get(name, ()):
            if how == "from" and what[1] == name:
                new = self.of_module(*what)
                if new != name and (new in scope.bound or any(new in w.bound for _, w in scope.refs[name])):
                    self.refused.append(f"{source.path}::{scope.path}: import of {name} as {new}: it is there")
                    return None
                return new
        return None

    def _strings_of(self, source, scope, call):
        """Names of attributes and static arguments that stand in strings."""
        word = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        if word in BY_NAME and len(call.args) > 1 and isinstance(call.args[1], ast.Constant):
            name = call.args[1].value
            if isinstance(name, str) and name.isidentifier():
                self.attribute(source, scope, call.args[0], name, call.args[1].at + 1, source.edit)
        for keyword in call.keywords:
            if keyword.arg in ("static", "static_argnames", "donate_argnames"):
                function = self._function_of(source, scope, call)
                for n in ast.walk(keyword.value):
                    if isinstance(n, ast.Constant) and isinstance(n.value, str) and function is not None:
                        new = self.of_function(function, n.value)
                        if new != n.value:
                            source.edit(n.at + 1, n.value, new)
                    elif (
                        isinstance(n, ast.Constant)
                        and isinstance(n.value, str)
                        and self.by_argument[n.value] - {n.value}
                    ):
                        self.undecided.append(f"{source.path}: static argument {n.value!r}")

    def _function_of(self, source, scope, call):
        for node in source.scope_of:
            if isinstance(node, ast.FunctionDef) and any(call in ast.walk(d) for d in node.decorator_list):
                return ("func", node, source, None)
            if isinstance(node, ast.Call) and node.args and (node.func is call or (node is call)):
                for t in self.project.infer(node.args[0], source, scope):
                    if t[0] == "func":
                        return t
        return None

    # text: docstrings and comments

    def _text(self, source):
        strings = self.table["strings"].get(source.path, {})
        for old, new in self.paths.items():
            if new == source.path:
                strings = strings | self.table["strings"].get(old, {})
        doc = {}
        for node in list(source.scope_of):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                if node.value in strings:
                    source.edit(node.at + 1, node.value, strings[node.value])
                elif re.fullmatch(r"(dropper_jax|fitting)([.:]\w+)+", node.value):
                    self._dotted_string(source, node)
        for how, what, _ in source.top.values.get("__all__", ()):
            for n in ast.walk(what) if how == "value" else ():
                if isinstance(n, ast.Constant) and isinstance(n.value, str):
                    new = self.of_module(source.module, n.value)
                    if new != n.value:
                        source.edit(n.at + 1, n.value, new)
        for scope in source.top.below():
            body = getattr(scope.node, "body", None)
            first = body[0].value if isinstance(body, list) and body and isinstance(body[0], ast.Expr) else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                doc[first.at] = (first.end, scope)
        if "#" in source.path:
            return
        for at, (end, scope) in doc.items():
            self._marked(source, at, end, scope)
            self._listed(source, at, end, scope)
        spans = sorted((s.node.at, s.node.end, i, s) for i, s in enumerate(source.top.below()) if hasattr(s.node, "at"))
        for match in re.finditer(r"#[^\n]*", source.text):
            if "`" in match[0]:
                inside = [s for a, b, _, s in spans if a <= match.start() < b and s.kind in ("function", "class")]
                self._marked(source, match.start(), match.end(), inside[-1] if inside else source.top)

    def _dotted_string(self, source, node):
        words, text = re.split(r"[.:]", node.value), node.value
        for old, new in self.dotted.items():
            if text == old or text.startswith((old + ".", old + ":")):
                text = new + text[len(old) :]
        module = self.project.by_module.get(".".join(words[:-1]))
        if module is not None:
            new = self.of_module(module.module, words[-1])
            text = (
                text[: len(text) - len(words[-1])] + new
                if new != words[-1] and f"{module.module}.{words[-1]}" not in self.dotted
                else text
            )
        else:
            module = self.project.by_module.get(".".join(words[:-2]))
            for t in self.project._name(words[-2], module, module.top) if module is not None else ():
                if t[0] == "class":
                    text = text[: len(text) - len(words[-1])] + self.of_member(t[1], words[-1])[1]
        if text != node.value:
            source.edit(node.at + 1, node.value, text)

    def _marked(self, source, at, end, scope):
        for match in re.finditer(r"`+([^`\n]+)`+", source.text[at:end]):
            for word in re.finditer(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", match[1]):
                first = at + match.start(1) + word.start()
                before = source.text[first - 1]
                if before in "\"'./-$" or source.text[first + len(word[0])] in "\"'/-":
                    continue
                self._reference(source, scope, word[0], first)

    def _reference(self, source, scope, text, at):
        words = text.split(".")
        home = scope.find(words[0])
        if len(words) == 1 or home is not None:
            new = None
            if home is not None and not (home.kind == "class" and home is not scope):
                new = self.names.get((home, words[0])) or self._imported(source, home, words[0])
                if home.kind == "class":
                    new = self.members.get((self.project.classes[home.node], words[0]), new)
            if new is None and home is None:
                cls = scope
                while cls is not None and cls.kind != "class":
                    cls = cls.parent
                if cls is not None:
                    known, name = self.of_member(self.project.classes[cls.node], words[0])
                    new = name if known else None
            if new is not None and new != words[0] and at not in source.edits:
                source.edit(at, words[0], new)
        position = at + len(words[0])
        tree = ast.Name(words[0], ast.Load())
        owners = [c for c in self.project.classes.values() if c.node.name == words[0]] if home is None else []
        modules = (
            [s for s in self.project.sources if s.module.endswith("." + words[0]) and s.path.startswith(PACKAGES)]
            if home is None
            else []
        )
        for name in words[1:]:
            position += 1
            if owners and len({self.of_member(c, name)[1] for c in owners}) == 1:
                new = self.of_member(owners[0], name)[1]
            elif len(modules) == 1:
                new = self.of_module(modules[0].module, name)
            else:
                new = self.of_types(self.project.infer(tree, source, scope), name)[1]
            if new != name and position not in source.edits:
                source.edit(position, name, new)
            position += len(name)
            tree, owners, modules = ast.Attribute(tree, name, ast.Load()), [], []

    def _listed(self, source, at, end, scope):
        """Arguments in the `Args:` of a docstring."""
        for match in re.finditer(r"(?m)^ +((?:\w+, )*\w+):(?: |$)", source.text[at:end]):
            for word in re.finditer(r"\w+", match[1]):
                if scope.kind == "class":
                    new = self.members.get((self.project.classes[scope.node], word[0]))
                else:
                    new = self.names.get((scope, word[0]))
                first = at + match.start(1) + word.start()
                if new is not None and new != word[0] and first not in source.edits:
                    source.edit(first, word[0], new)


BUILTINS = set(dir(__builtins__)) if not isinstance(__builtins__, dict) else set(__builtins__)


def inside(scope, other):
    while scope is not None and scope is not other:
        scope = scope.parent
    return scope is other


def distinct(types):
    found = []
    for t in types:
        if not any(t is u or (t[0] == u[0] in ("inst", "class", "mod") and t[1] is u[1]) for u in found):
            found.append(t)
    return found[:40]


def arguments(node):
    args = node.args
    return [a.arg for a in (*args.posonlyargs, *args.args, *args.kwonlyargs)]


def dotted(path):
    return path.removesuffix(".py").replace("/", ".")


def sources_of(paths):
    """Files, and the blocks of Python in pages."""
    found = []
    for path in paths:
        text = Path(path).read_text(encoding="utf-8")
        if path.endswith((".py", ".pyi")):
            found.append(Source(path, text))
        elif path.endswith(".md"):
            for i, match in enumerate(re.finditer(r"(?ms)^```python\n(.*?)^```", text)):
                try:
                    found.append(Source(f"{path}#{i}", match[1]))
                except SyntaxError:
                    continue
    return found


def main():
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    for key in ("modules", "definitions", "members", "locals", "arguments", "strings", "receivers", "texts", "keep"):
        table.setdefault(key, {})
    tracked = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"], capture_output=True, text=True, check=True
    ).stdout.split("\n")
    paths = [p for p in tracked if p.startswith(tuple(f"{r}/" for r in ROOTS)) and p not in MINE and Path(p).is_file()]
    paths += [p for p in TEXTS if Path(p).is_file()]
    sources = sources_of([p for p in paths if p.endswith((".py", ".pyi", ".md"))])
    renames = Renames(table, Project(sources))
    for source in sources:
        renames.rewrite(source)
    for line in [*dict.fromkeys(renames.refused)]:
        print("refused   ", line)
    for line in renames.left:
        print("left      ", line)
    for line in renames.undecided:
        print("undecided ", line)
    if "--edits" in sys.argv:
        for source in sources:
            for at, (old, new) in sorted(source.edits.items()):
                print(f"{source.path}:{source.text.count(chr(10), 0, at) + 1}: {old} -> {new}")
    if "--assumed" in sys.argv:
        for line in renames.assumed:
            print("assumed   ", line)
    changed = [s for s in sources if s.edits]
    print(
        f"{sum(len(s.edits) for s in changed)} edits in {len(changed)} files; "
        f"{len(renames.assumed)} attributes of unknown owners"
    )
    if renames.refused:
        raise SystemExit("refused: nothing is written")
    if "--check" not in sys.argv:
        write(paths, changed, table)


def write(paths, changed, table):
    texts, blocks = {}, defaultdict(dict)
    for source in changed:
        path, _, number = source.path.partition("#")
        if number:
            blocks[path][int(number)] = source.result()
        else:
            texts[path] = source.result()
    for path in paths:
        if path.endswith((".png", ".npz", ".nc", ".mp4", ".gif", ".webp", ".csv", ".npy")):
            continue
        try:
            before = Path(path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        text = texts.get(path, before)
        if path in blocks:
            parts = re.split(r"(?ms)(^```python\n)(.*?)(^```)", text)
            for number, new in blocks[path].items():
                parts[4 * number + 2] = new
            text = "".join(parts)
        for old, new in table["modules"].items():
            text = re.sub(rf"(?<![\w/]){re.escape(old)}\b", new, text)
            text = re.sub(rf"(?<![\w.]){re.escape(dotted(old))}\b(?!/)", dotted(new), text)
            inner_old, inner_new = old.partition("/")[2], new.partition("/")[2]
            if path.endswith((".md", ".py")) and "/" in inner_old:
                text = re.sub(rf"(?<![\w/]){re.escape(inner_old)}\b", inner_new, text)
        for pattern, rows in table["texts"].items():
            if re.fullmatch(pattern, path):
                for old, new in rows:
                    text = re.sub(old, new, text)
        if text != before:
            Path(path).write_text(text, encoding="utf-8")
    for old, new in table["modules"].items():
        if Path(old).exists():
            Path(new).parent.mkdir(parents=True, exist_ok=True)
            subprocess.run(["git", "mv", old, new], check=True)
    python = [sys.executable, "-m", "ruff"]
    subprocess.run([*python, "check", "--quiet", "--select", "I", "--fix", *ROOTS], check=False)
    subprocess.run([*python, "format", "--quiet", *ROOTS], check=False)


if __name__ == "__main__":
    main()
