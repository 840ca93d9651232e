"""A site on file: SITE.toml, the farm with its load cases, parts, anchors and months.

    scene = "farm.toml"             a scene in the folder of this file, or a packaged one
    name, description               texts, optional
    unchecked = ["tail-*"]          lines that deliberately belong to no part

    [parameters]                    of the scene, changed here: numbers or expressions
    [set]                           further values of the scene by path: "sea.depth" = 25.0

    [run]                           settings of every run
    duration = 600.0                [s]
    accuracy = 0.01                 which the steps follow; or equal steps, dt = 0.03 [s]; default: as the scene
    seeds = 10                      realisations of each sea, from first_seed = 1 on
    skip = 30.0                     [s] at the start that are not counted; ramp = 15.0 [s] of the waves
    characteristic = "mean"         of the seeds' maxima, or "most_probable" of a storm of `storm` = 10800 s
    confidence = 0.9                of intervals
    halvings = 1                    of the step, for its error, with the first `step_seeds` = 3 seeds

    [[sea_state]]                   name, hs [m], tp [s], spectrum, gamma, spreading, count, frequencies as in
    name = "storm"                  [sea.waves]; hours [h] of it in a year, for fatigue

    [cases]                         every combination of these, with every sea state and every seed
    directions = [0.0, 90.0]        [deg] towards which the waves travel, from x towards y
    currents = [0.0, 0.9]           [m/s], with the profile of the scene; or tables as [sea.current]
    current_direction = "waves"     with them, or [deg]
    levels = [-1.0, 1.0]            [m] of the tide above z = 0, in place of the scene's level
    months = ["may", "september"]   of [[growth]]; default: the bare scene
    states = ["intact", "west-leg"] or a line (patterns: each of their lines) that breaks in its middle link,
    standard = "ns-9415"            keeps pairs of return periods: `return_period` of sea states and currents; or
                                    pairs = [[50, 10], [10, 50]], see docs/farms.md
    crops = ["low", "high"]         values of [crop]; default: all three
    break_time = 60.0               [s], so that the transient is in the run ("west-leg:3" breaks in link 3);
                                    default: the middle of the counted time

    [[growth]]                      mussels of a month, months in order; several tables make one month
    month = "may"
    lines = "loop-*"
    depth = [0.0, 10.0]             [m]; thickness [m] and density [kg/m^3] as in [line.growth]

    [crop]                          low, expected and high values of numbers of the scene, by path; `growth`: factor of
    line_type.sock.cdn = [1.0, 1.4, 3.9]    the thickness of [[growth]]

    [factors]                       the user's table: load times factor is compared with capacity
    intact = 1.67
    broken = 1.25                   in cases where a line breaks
    source, edition, clause         references, as texts
    standard = "api-rp-2sk"         or factors with edition and clause by name, see docs/farms.md

    [[part]]                        lines of one kind; every line belongs to one part
    name = "loops"
    lines = "loop-*"                a pattern, or a list of them
    capacity = 20e3                 [N] breaking load, default: that of the scene's lines
    factor = 2.0                    or { intact = 2.0, broken = 1.5 }, or a standard; default: that of [factors]
    curve = { k = 25000.0, m = 5.2, source = "..." }    N = k (range/capacity)^-m; "no curve given" without

    [[anchor]]                      fixed points: name, points (patterns), kind with its values as in [[anchor]] of a
    points = "*-anchor"             scene; factor; uplift [deg], the maximum allowed
    kind = "tested"
    capacity = 80e3

    [exclusion]                     maximum horizontal `excursion` [m] of nodes of `lines` from calm water
    [backbone]                      `lines` between `shallowest` and `deepest` [m] below the water's level at rest
    [season]                        floats: `points`, `volume` [m^3], `density` [kg/m^3], `reserve`, `least_share`,
                                    `start`, `currents`, `levels` (see `fitting.farm.season`)

    [[variable]], [objective], [[constraint]], [optimise]    passed on unchanged: `Site.raw`

Patterns are those of a shell: `loop-*`, `?-leg`, `[ab]*`.
"""

from fitting.farm.site.case import Case, Storm
from fitting.farm.site.parts import Anchor, Part
from fitting.farm.site.reader import packaged_sites, read_site, site_text
from fitting.farm.site.site import Site

__all__ = ["Anchor", "Case", "Part", "Site", "Storm", "packaged_sites", "read_site", "site_text"]
