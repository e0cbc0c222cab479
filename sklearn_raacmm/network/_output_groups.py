"""Which outputs share kernel and widths, and which have their own, by the likelihood.

What the shared search has found is where every output starts from. A few steps for each output by
itself show what it would gain with widths of its own; where that is little, as for outputs of the
same causes, nothing else is asked. Otherwise groups are formed, the output that gains most first:
each joins the group with which it can share widths at the least loss, or opens another one where
this loss is clear. All this is done on a few hundred rows, for that is enough to tell widths that
matter apart, and outputs that agree pay for the first question only.
"""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._likelihood import leave_one_out, log_likelihood
from sklearn_raacmm.network._width_objective import WIDTH_BOUNDS, Task
from sklearn_raacmm.network._width_search import COARSE_ROWS, robust_spread, search

# Nats by which the objective of the widths has to fall with one group of outputs more. Of 240
# simulated tables of 2 to 4 outputs with the same widths (some noise alone, or with noise of heavy
# tails, outliers or skew) one gained more than 5, and that one 10.1 and 33 nats of density; outputs
# of two and three times the frequency of others gained 11 to 94 where rows could show it.
MARGIN = 10.0
# The same of likelihood alone, for an output that is said to be given up: noise of long tails
# gained 30 once in 100 simulated fits, functions that were clear 91 to 191.
GIVEN_UP = 40.0
# Iterations of a search that starts from the shared widths: after them outputs were within 2 nats
# of what a whole search found, but for outputs that had been given up.
STEPS = 6
# Nats that an output gains by chance with each width of its own.
CHANCE = 0.5
# Most outputs that are looked at one by one: from eight on a shared search takes one decomposition
# for all, and a search for each would take longer than it.
MOST_OUTPUTS = 16


class _Group(NamedTuple):
    """Outputs that share kernel and widths, and what these are on the rows looked at."""

    outputs: list
    kernel: str
    widths: np.ndarray  # logarithms, as `Task` has them
    ridges: dict  # logarithm of the ridge of every output
    value: float = np.nan  # objective, nats
    start: float = np.nan  # the same where the search started
    noise: tuple = ()  # outputs that are taken for noise where others are not


class _Rows:
    """A few hundred rows, on which sets of outputs are tried.

    Parameters
    ----------
    data : Data
    isotropic : bool
    alpha : ndarray of shape (q,) or None
        Given ridges.
    """

    def __init__(self, data, isotropic, alpha):
        # The same rows whatever `random_state` is: an outcome hangs on the data alone.
        rows = np.sort(np.random.RandomState(0).permutation(len(data.X))[:COARSE_ROWS])
        few = data.rows(rows)
        self.few = few._replace(X=few.X - np.average(few.X, axis=0, weights=few.weights))
        self.isotropic, self.alpha = isotropic, alpha
        spread = robust_spread(few.X, few.weights)
        self.used, self.spread = spread > 0, np.where(spread > 0, spread, 1.0)

    def data(self, outputs):
        """Data of some outputs."""
        return self.few._replace(Y=self.few.Y[:, outputs], within=self.few.within[outputs])

    def task(self, outputs):
        """The search for the widths of some outputs."""
        alpha = None if self.alpha is None else self.alpha[outputs]
        return Task(self.data(outputs), self.spread, None, self.isotropic, alpha, self.used)

    def widths_of(self, length_scale):
        """Widths as parameters of a search; that of a feature left out is at its upper bound."""
        log_width = np.log(length_scale[self.used] / self.spread[self.used])
        return np.minimum(log_width, np.log(WIDTH_BOUNDS[1]))[: 1 if self.isotropic else None]

    def shared(self, found):
        """What all outputs share, as it has been found on other rows."""
        q, ridges = len(found.alpha), dict(enumerate(np.log(found.alpha)))
        noise = _taken_for_noise(found) if self.alpha is None else ()
        widths = self.widths_of(found.length_scale)
        return _Group(list(range(q)), found.kernel, widths, ridges, noise=noise)

    def group(self, outputs, kernel, starts, ridges):
        """Widths that some outputs share, after a few steps from the better of some starts."""
        task = self.task(outputs)
        log_alpha = [ridges[i] for i in outputs][: task.n_alphas]
        starts = [np.append(start, log_alpha) for start in starts]
        if len(starts) > 1:
            starts.sort(key=lambda theta: task.objective(theta, task.data, kernel)[0])
        end = task.minimise(starts[0], np.arange(len(self.few.X)), kernel, STEPS)
        found = dict(zip(outputs, task.unpack(end.theta)[1], strict=True))
        return _Group(outputs, kernel, end.theta[: task.n_widths], found, end.value, end.start)

    def judged(self, group, of=log_likelihood):
        """The likelihood, or another function, of a group's outputs."""
        task = self.task(group.outputs)
        theta = np.append(group.widths, [group.ridges[i] for i in group.outputs][: task.n_alphas])
        return of(task.data, group.kernel, *task.unpack(theta))

    def density(self, groups):
        """Logarithm of the leave-one-out density of all outputs."""
        return -sum(self.judged(group, leave_one_out).negative_log_density for group in groups)


def output_groups(data, found, isotropic=False, alpha=None):
    """Groups of outputs that are clearly more probable with kernel and widths of their own.

    Parameters
    ----------
    data : Data
        Targets in units of their spread.
    found : Found
        What all outputs share.
    isotropic : bool, default=False
        One width for all features.
    alpha : ndarray of shape (q,), optional
        Given ridges.

    Returns
    -------
    list of ndarray
        Columns of Y, each of them once; one array where all shall share widths.
    """
    q = data.Y.shape[1]
    everything = [np.arange(q)]
    rows = _Rows(data, isotropic, alpha)
    if not 1 < q <= MOST_OUTPUTS or not np.any(rows.used):
        return everything
    shared = rows.shared(found)
    alone, gains = _alone(rows, shared, range(q))
    if not np.maximum(gains - CHANCE * len(shared.widths), 0.0).sum() > MARGIN:
        return everything
    shared = rows.group(shared.outputs, shared.kernel, [shared.widths], shared.ridges)
    groups = _formed(rows, [alone[i] for i in np.argsort(-gains, kind="stable")])
    gain = shared.value - sum(group.value for group in groups)
    enough = len(groups) > 1 and gain > MARGIN * (len(groups) - 1)
    if not enough or rows.density(groups) < rows.density([shared]):
        return everything
    return sorted((np.sort(group.outputs) for group in groups), key=lambda of: of[0])


def outputs_given_up(data, found, isotropic=False):
    """Outputs that are noise with the widths of the others, and clearly a function with their own.

    For where widths and ridges are found, but outputs have to share the former.
    """
    rows = _Rows(data, isotropic, None)
    if not np.any(rows.used):
        return []
    noise = _taken_for_noise(found)
    alone, gains = _alone(rows, rows.shared(found), noise)
    given_up = zip(noise, alone, gains, strict=True)
    return [i for i, one, gain in given_up if gain > GIVEN_UP and one.ridges[i] < 0]


def _taken_for_noise(found):
    """Outputs that are taken for noise where others are not."""
    noise = np.flatnonzero(found.alpha > 1)
    return noise.tolist() if len(noise) < len(found.alpha) else []


def _alone(rows, shared, outputs):
    """Some outputs, each by itself, and the nats of likelihood that it gains by that."""
    alone, gains = [], []
    for i in outputs:
        if i in shared.noise:
            # Taken for noise, it has no slope along which a few steps would find its widths.
            options = {"isotropic": rows.isotropic, "random_state": np.random.RandomState(0)}
            own = search(rows.data([i]), [shared.kernel], **options)
            start, ridge = rows.widths_of(own.length_scale), np.log(own.alpha[0])
            group = rows.group([i], own.kernel, [start], {i: ridge})
        else:
            group = rows.group([i], shared.kernel, [shared.widths], shared.ridges)
        alone.append(group)
        # The likelihood alone, without what an output saves of the price of features.
        gain = group.start - group.value
        if i in shared.noise or gain > CHANCE * len(group.widths):
            gain = rows.judged(group) - rows.judged(shared._replace(outputs=[i]))
        gains.append(gain)
    return alone, np.array(gains)


def _formed(rows, alone):
    """Groups of outputs, which come in order of what they gain by widths of their own."""
    groups = []
    for one in alone:
        joined, losses = [], []
        for group in groups:
            together, ridges = group.outputs + one.outputs, group.ridges | one.ridges
            both = rows.group(together, group.kernel, [group.widths, one.widths], ridges)
            joined.append(both)
            losses.append(both.value - group.value - one.value)
        best = int(np.argmin(losses)) if groups else None
        if best is None or losses[best] > MARGIN:
            groups.append(one)
        else:
            groups[best] = joined[best]
    return groups
