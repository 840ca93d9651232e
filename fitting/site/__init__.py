"""A site on file: SITE.toml, the farm with its load cases, parts, anchors and months.

    scene = "farm.toml"             a scene beside this file, or a packaged one
    name, description               texts, optional
    unchecked = ["tail-*"]          lines that belong to no part, on purpose

    [parameters]                    of the scene, changed here: numbers or expressions
    [set]                           further values of the scene by path: "sea.depth" = 25.0

    [run]                           of every run
    duration = 600.0                [s]
    dt = 0.03                       [s], the scene's where left out
    seeds = 10                      realisations of each sea, from first_seed = 1 on
    skip = 30.0                     [s] at the start that count for nothing; ramp = 15.0 [s] of the waves
    characteristic = "mean"         of the seeds' maxima, or "most_probable" of a storm of `storm` = 10800 s
    confidence = 0.9                of intervals
    halvings = 1                    of the step, for its error, with the first `step_seeds` = 3 seeds

    [[sea_state]]                   name, hs [m], tp [s], spectrum, gamma, spreading, count, frequencies as in
    name = "storm"                  [sea.waves]; hours [h] of it in a year, for fatigue

    [cases]                         every combination of these, with every sea state and every seed
    directions = [0.0, 90.0]        [deg] towards which the waves travel, from x towards y
    currents = [0.0, 0.9]           [m/s], with the profile of the scene; or tables as [sea.current]
    current_direction = "waves"     with them, or [deg]
    levels = [-1.0, 1.0]            [m] of the tide over the scene's level
    months = ["may", "september"]   of [[growth]]; the bare scene where left out
    states = ["intact", "west-leg"] or a line (patterns: each of their lines) that breaks in its middle link,
    break_time = 60.0               [s], so that what follows at once is in the run ("west-leg:3" breaks in link 3);
                                    in the middle of what counts where left out

    [[growth]]                      mussels of a month, months in their order; several tables make one month
    month = "may"
    lines = "loop-*"
    depth = [0.0, 10.0]             [m]; thickness [m] and density [kg/m^3] as in [line.growth]

    [factors]                       the user's table: load times factor against capacity
    intact = 1.67
    broken = 1.25                   in cases where a line breaks
    source, edition                 where it is from: texts

    [[part]]                        lines of one kind; every line belongs to one part
    name = "loops"
    lines = "loop-*"                a pattern, or a list of them
    capacity = 20e3                 [N] breaking load; that of the scene's lines where left out
    factor = 2.0                    or { intact = 2.0, broken = 1.5 }; that of [factors] where left out
    curve = { k = 25000.0, m = 5.2, source = "..." }    N = k (range/capacity)^-m; "no curve given" without

    [[anchor]]                      held points: name, points (patterns), kind, weight, friction, capacity as in
    points = "*-anchor"             [[anchor]] of a scene; factor; uplift [deg], the largest allowed
    kind = "tested"
    capacity = 80e3

    [exclusion]                     how far nodes of `lines` may go: `excursion` [m] from calm water, horizontally
    [backbone]                      `lines` between `shallowest` and `deepest` [m] below the water's level at rest
    [season]                        floats: `points`, `volume` [m^3], `density` [kg/m^3], `reserve`, `least_share`,
                                    `start`, `currents`, `levels` (see `fitting.season`)

    [[variable]], [objective], [[constraint]], [optimise]    passed on as they are: `Site.raw`

Patterns are those of a shell: `loop-*`, `?-leg`, `[ab]*`.
"""

from fitting.site.case import Case, Storm
from fitting.site.parts import Anchor, Part
from fitting.site.reader import packaged_sites, read_site, site_text
from fitting.site.site import Site

__all__ = ["Anchor", "Case", "Part", "Site", "Storm", "packaged_sites", "read_site", "site_text"]
