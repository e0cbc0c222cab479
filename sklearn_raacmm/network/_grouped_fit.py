"""Outputs of a network as one group, or as several with kernel, widths and centres of their own.

A group is fitted as its outputs would be by themselves, on the same draws of rows. What outputs of
several groups have in common is the data: rows, weights, and a polynomial tail that was asked for.
"""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._grouped_posterior import GroupedPosterior
from sklearn_raacmm.network._kernels import KERNELS
from sklearn_raacmm.network._large_data import ChunkedProblem
from sklearn_raacmm.network._network_fit import FittedNetwork, fit_network
from sklearn_raacmm.network._training_data import Problem
from sklearn_raacmm.network._tuning import Tuned, tune
from sklearn_raacmm.utils import show


class Given(NamedTuple):
    """Kernel, widths and ridge as far as they are given, and what of them may be found."""

    kernel: str | np.ndarray  # "auto", a name, or names (q,)
    length_scale: np.ndarray | None  # (d,), or (q, d)
    alpha: np.ndarray | None  # (q,)
    isotropic: bool
    may_be_linear: bool

    @property
    def by_output(self):
        """Whether every output has widths that are given."""
        return np.ndim(self.length_scale) == 2

    def of(self, outputs):
        """What is given of outputs that share kernel and widths."""
        i = outputs[0]
        return self._replace(
            kernel=self.kernel if isinstance(self.kernel, str) else str(self.kernel[i]),
            length_scale=self.length_scale[i] if self.by_output else self.length_scale,
            alpha=None if self.alpha is None else self.alpha[outputs],
        )


class Group(NamedTuple):
    """Outputs that share kernel, widths and centres, and what these are chosen with."""

    outputs: np.ndarray
    problem: object  # Problem of these outputs, or ChunkedProblem of all
    tuned: Tuned
    rng: np.random.RandomState
    last: object = None  # posterior of an earlier fit, or None


def check_kernel(kernel, length_scale, n_outputs):
    """Kernel as a name, or as an array of one an output, which given widths have to go with."""
    if isinstance(kernel, str):
        return kernel
    names = np.asarray(kernel)
    if names.shape != (n_outputs,) or not all(name in KERNELS for name in names.tolist()):
        raise ValueError(
            f"kernel must be a name, or one of {', '.join(KERNELS)} for each of the {n_outputs} "
            f"outputs; got {show(kernel)}."
        )
    if np.ndim(length_scale) != 2:
        raise ValueError(
            "A kernel for each output needs length_scale of shape (n_outputs, n_features), too."
        )
    return names


def tuned_groups(problem, given, settings, rng, last=None):
    """Groups of outputs, and kernel, widths and ridges of each, found where they are not given.

    Parameters
    ----------
    problem : Problem or ChunkedProblem
    given : Given
    settings : CenterSettings
    rng : numpy.random.RandomState
        Draws the rows of the search: the same for every group.
    last : Posterior or GroupedPosterior, optional
        Of other rows, for a warm start.

    Returns
    -------
    list of Group

    Raises
    ------
    ValueError
        If widths are given for every output, but rows are read in blocks or have groups.
    """
    state = rng.get_state()
    if given.by_output:
        if isinstance(problem, ChunkedProblem) or problem.codes is not None:
            raise ValueError(
                "length_scale for each output is for data in memory and without offsets of groups: "
                "fit one network for each."
            )
        return list(map(_tuned, *_alone(problem, given, _alike(given, len(problem.spread)), state)))
    # A number of centres that is asked for is that of all outputs together.
    asked = settings.n_centers is not None or settings.selection == "newrb"
    may_split = isinstance(problem, Problem) and problem.codes is None and not asked
    if isinstance(last, GroupedPosterior):
        if may_split:
            groups = list(map(_tuned, *_alone(problem, given, last.outputs(), state, last.parts)))
            if all(group.tuned.kept for group in groups):
                return groups
        last = None
    one = _tuned(problem, given, np.arange(len(problem.spread)), rng, last, may_split)
    if one.tuned.apart:
        groups = list(map(_tuned, *_alone(problem, given, one.tuned.apart, state)))
        # They were formed on a few hundred rows; these are all on which kernels are compared.
        if sum(group.tuned.log_likelihood for group in groups) > one.tuned.log_likelihood:
            return groups
    return [one]


def _tuned(problem, given, outputs, rng, last, split=None):
    """One group of outputs, which the problem has; warnings count the frames up to the caller."""
    tuned = tune(problem, *given.of(outputs)[:4], rng, last, given.may_be_linear, split)
    return Group(outputs, problem, tuned, rng, last)


def _alone(problem, given, outputs, state, last=None):
    """Arguments for `_tuned` of groups of outputs, each as it would be by itself."""
    rngs = [np.random.RandomState() for _ in outputs]
    for rng in rngs:
        rng.set_state(state)
    problems = [problem.of_outputs(of) for of in outputs]
    return problems, [given] * len(outputs), outputs, rngs, last or [None] * len(outputs)


def _alike(given, n_outputs):
    """Outputs with the same kernel and widths, in order of the first."""
    groups = {}
    for i in range(n_outputs):
        own = given.of([i])
        groups.setdefault((own.kernel, own.length_scale.tobytes()), []).append(i)
    return [np.array(of) for of in groups.values()]


def fit_groups(groups, settings):
    """Choose the centres of every group and fit its weights.

    Parameters
    ----------
    groups : list of Group
    settings : CenterSettings

    Returns
    -------
    FittedNetwork
        Of all outputs; what there is one of for each centre comes one group after another.
    """
    found = []
    for group in groups:  # no comprehension, which is a frame that warnings would have to count
        _, problem, tuned, rng, last = group
        found.append(fit_network(problem, tuned, settings, rng, last))
    if len(found) == 1:
        return found[0]
    number = np.empty(sum(len(group.outputs) for group in groups), dtype=int)
    for i, group in enumerate(groups):
        number[group.outputs] = i
    varying = [np.sum(group.problem.spread > 0) for group in groups]
    shares = [
        one.error_reduction * of / max(1, sum(varying))
        for one, of in zip(found, varying, strict=True)
    ]
    return FittedNetwork(
        GroupedPosterior(tuple(one.posterior for one in found), number),
        sum(one.slopes for one in found),
        np.concatenate([one.centers for one in found]),
        sum(one.n_tried for one in found),
        np.concatenate([one.scores for one in found]),
        np.concatenate(shares),
        ", ".join(one.stop_reason for one in found),
    )
