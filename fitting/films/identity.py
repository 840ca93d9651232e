"""Assignment of circles to nodes, frame by frame: by expected positions and by the chain's order and lengths.

For the circles of a frame the assignment minimises the sum over nodes of `(deviation from the expected position / its
error)^2` and over links of `(length - known length)^2 / its error^2`, with a penalty for each undetected node and no
circle used twice. Along the chain this is a dynamic programme (Viterbi 1967), exact and cheap. Two markers that come
close are distinguished by the lengths of the links on either side. An undetected node is bridged: it continues as
expected, shifted to where the links to its neighbours put it. When it reappears, it is accepted as soon as a circle
within its reach fits the lengths, because the expectation for a node that was hidden for long is uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fitting.films.ordering import Chain, distances

#: Fastest step before any was observed, in mean links.
FIRST_STEP = 0.3
#: Change per step before any rate is known, in mean links, and its minimum [pixel].
FIRST_CHANGE = 0.12
LEAST_FIRST_CHANGE = 4.0
#: Fraction of the fastest step that is kept in every frame.
FASTEST_DECAY = 0.95
#: Fraction of the last step by which a node may be off.
STEP_SHARE = 0.05
#: Fraction of the last change of a step by which a node may be off.
CHANGE_SHARE = 0.7
#: Maximum distance of a circle from a node's expected position [pixel].
MAX_DISTANCE = 12.0
#: Additional distance for every frame that the node was lost, in fastest steps.
REACH_PER_FRAME = 1.5
#: Maximum cost of a length between two nodes: a wrong neighbour must not reject a right node.
LARGEST_MISS = 30.0
#: Cost of an undetected node, in squared standard deviations: 4 sigma.
LOST_COST = 16.0
#: Cost of a node that reappears away from its expected position, in squared standard deviations.
RETURN_COST = 12.0
#: Error of a length [standard deviations] up to which a link confirms that a node reappears.
CONFIRMED_DEVIATIONS = 3.0
#: Minimum error of an expected position [pixel].
POSITION_ERROR = 1.5
#: Error of a bridged position that continues at its rate [pixel].
BRIDGE_ERROR = 5.0
#: Minimum error of a length [pixel], and as a fraction of the length.
LENGTH_ERROR = 0.6
LENGTH_SHARE = 0.008
#: Maximum variation of a length as a fraction of it.
LARGEST_SPREAD = 0.25
#: Maximum number of shared circles that are denied to one of two nodes in turn.
MAX_DENIED = 8


class Follower:
    """The state of the chain from frame to frame, from its own frame forwards in time (direction 1) or backwards (-1).

    Attributes:
        chain: positions at the first frame, lengths.
        past: the last positions (n, 2), newest first, at most three.
        held: nodes that rest (n,).
        lost: frames since the last detection of each node (n,).
        last_positions: of the last detection of each node (n, 2).
        fastest: recent fastest step of a node [pixel].
    """

    def __init__(self, chain: Chain, direction: int = 1) -> None:
        self.chain = chain
        self.past = [chain.positions]
        if chain.rate is not None:
            self.past.append(chain.positions - direction * chain.rate)
        self.lost = np.zeros(len(chain.positions), int)
        self.held = np.zeros(len(chain.positions), bool) if chain.held is None else chain.held
        self.last_positions = chain.positions
        self.fastest = FIRST_STEP * np.mean(chain.length)
        self.length_error = length_errors(chain)

    def expected_positions(self) -> np.ndarray:
        """Positions (n, 2) expected in the next frame: by a parabola through the last three, or a line through two."""
        if len(self.past) == 1:
            return self.past[0]
        guess = self.past[0] + self._differences(1) + self._differences(2)
        return self._at_rest(self._bridge(guess, self.lost > 0))

    def _differences(self, order: int) -> np.ndarray:
        """The last differences (n, 2) in time of first or second order; 0 before there are any."""
        if len(self.past) <= order:
            return np.zeros_like(self.past[0])
        return np.diff(self.past[order::-1], order, axis=0)[0]

    def _at_rest(self, positions: np.ndarray) -> np.ndarray:
        """The positions (n, 2) with resting nodes at their own."""
        return np.where(self.held[:, None], self.chain.positions, positions)

    def _errors(self) -> np.ndarray:
        """Errors (n,) [pixel] of the expected positions, which grow with the rate and while a node is lost."""
        step = np.linalg.norm(self._differences(1), axis=1)
        change = max(LEAST_FIRST_CHANGE, FIRST_CHANGE * np.mean(self.chain.length))
        if len(self.past) > 2:
            change = np.linalg.norm(self._differences(2), axis=1)
        moving = (POSITION_ERROR + STEP_SHARE * step + CHANGE_SHARE * change) * (1.0 + self.lost)
        return np.where(self.held, POSITION_ERROR, moving)

    def advance(self, centres: np.ndarray) -> np.ndarray:
        """Process the circles (m, 2) of the next frame; returns for each node the number of its circle, or -1 (n,)."""
        guess = self.expected_positions()
        found = self._assign(centres, guess)
        detected = found >= 0
        positions = self._at_rest(guess)
        positions[detected] = centres[found[detected]]
        positions = self._bridge(positions, ~detected & ~self.held)
        steady = np.linalg.norm(positions - self.past[0], axis=1)[detected & (self.lost == 0)]
        self.fastest = max(FASTEST_DECAY * self.fastest, steady.max(initial=0.0))
        self.last_positions = np.where(detected[:, None], positions, self.last_positions)
        self.lost = np.where(detected, 0, self.lost + 1)
        self.past = [positions, *self.past[:2]]
        return found

    def _assign(self, centre: np.ndarray, guess: np.ndarray) -> np.ndarray:
        """For each node, expected at `guess` (n, 2), the number of its circle of these (m, 2), or -1 (n,)."""
        if not len(centre):
            return np.full(len(guess), -1)
        unary = (distances(guess, centre) / self._errors()[:, None]) ** 2
        reach = np.where(self.held, 0.0, MAX_DISTANCE + REACH_PER_FRAME * self.lost * self.fastest)
        away = distances(self.last_positions, centre) < reach[:, None]
        far = (self.lost > 0)[:, None] & away & (unary >= RETURN_COST)
        unary[far] = RETURN_COST
        unary[unary > 2 * LOST_COST] = np.inf
        unary = np.pad(unary, ((0, 0), (0, 1)), constant_values=LOST_COST)
        miss = (distances(centre, centre) - self.chain.length[:, None, None]) / self.length_error[:, None, None]
        pair = np.pad(np.minimum(miss**2, LARGEST_MISS), ((0, 0), (0, 1), (0, 1)))
        pair[:, np.arange(len(centre)), np.arange(len(centre))] = np.inf
        best = _without_doubles(unary, pair)[1]
        return self._confirm_returns(np.where(best == len(centre), -1, best), far, pair)

    def _confirm_returns(self, found: np.ndarray, far: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """The assignment (n,) without reappearing nodes far off that no neighbouring link confirms."""
        for k in np.flatnonzero(found >= 0):
            if far[k, found[k]]:
                links = [j for j in (k - 1, k) if 0 <= j < len(pair) and found[j] >= 0 and found[j + 1] >= 0]
                costs = [pair[j, found[j], found[j + 1]] for j in links]
                if max(costs, default=np.inf) > CONFIRMED_DEVIATIONS**2:
                    found[k] = -1
        return found

    def _bridge(self, positions: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        """Positions in which the `unknown` nodes (n,) continue at their rate, fitted to the links (Gauss-Newton).

        If both neighbours are known and the links are not in line, they fix the position. If they are in line, the
        lengths do not determine the direction across them, and the rate carries the node through.
        """
        if not unknown.any():
            return positions
        positions = np.where(unknown[:, None], self.past[0] + self._differences(1), positions)
        return bridge(positions, unknown, self.chain.length, self.length_error)


def follow(centres: Sequence[np.ndarray], chain: Chain) -> np.ndarray:
    """Number of each node's circle in each frame (k, n), -1 if not detected, followed from `chain.at` both ways.

    Args:
        centres: of the circles (m, 2) of each frame.
    """
    found = np.full((len(centres), len(chain.positions)), -1)
    frames = np.arange(len(centres))
    for direction, these in ((1, frames[chain.at :]), (-1, frames[chain.at :: -1])):
        follower = Follower(chain, direction)
        for i in these:
            found[i] = follower.advance(centres[i])
    return found


def length_errors(chain: Chain) -> np.ndarray:
    """Permitted errors of the links' lengths (n - 1,) [pixel]."""
    low = np.maximum(LENGTH_ERROR, LENGTH_SHARE * chain.length)
    return np.maximum(low, np.minimum(chain.spread, LARGEST_SPREAD * chain.length))


def bridge(positions: np.ndarray, unknown: np.ndarray, length: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Positions (n, 2) of which the `unknown` (n,) are fitted to the links' lengths (n - 1,) (Gauss-Newton)."""
    positions = positions.copy()
    expected = positions[unknown]
    ends = np.diff(np.eye(len(positions)), axis=0)[:, unknown]  # signs with which a node ends a link
    for _ in range(6):
        link = np.diff(positions, axis=0)
        size = np.maximum(np.linalg.norm(link, axis=1), 1e-6)
        rows = (ends[..., None] * (link / (size * error)[:, None])[:, None]).reshape(len(link), -1)
        off = (positions[unknown] - expected).ravel() / BRIDGE_ERROR**2
        normal = rows.T @ rows + np.eye(expected.size) / BRIDGE_ERROR**2
        move = np.linalg.solve(normal, rows.T @ ((length - size) / error) - off)
        positions[unknown] += move.reshape(-1, 2)
    return positions


def _without_doubles(unary: np.ndarray, pair: np.ndarray, depth: int = 0) -> tuple[float, np.ndarray]:
    """The cheapest assignment in which no circle serves two nodes: a shared circle is denied to either in turn."""
    cost, states = _viterbi(unary, pair)
    circles, counts = np.unique(states[states < unary.shape[1] - 1], return_counts=True)
    double = circles[counts > 1]
    if not len(double) or depth >= MAX_DENIED:
        return cost, states
    tries = []
    owners = np.flatnonzero(states == double[0])
    for keeper in owners:
        denied = unary.copy()
        denied[owners[owners != keeper], double[0]] = np.inf
        tries.append(_without_doubles(denied, pair, depth + 1))
    return min(tries, key=lambda found: found[0])


def _viterbi(unary: np.ndarray, pair: np.ndarray) -> tuple[float, np.ndarray]:
    """Minimum sum of unary (n, m) and pair (n - 1, m, m) costs along a chain, and its states (n,)."""
    cost = unary[0]
    back = []
    for step, own in zip(pair, unary[1:], strict=True):
        total = cost[:, None] + step
        back.append(np.argmin(total, axis=0))
        cost = np.min(total, axis=0) + own
    states = [np.argmin(cost)]
    for choice in reversed(back):
        states.append(choice[states[-1]])
    return cost.min(), np.array(states[::-1])
