"""What a call reports: findings about the data, warnings at the user's line, stages of a fit.

A finding is made once, and is the same in every place that shows it.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import logging
import warnings
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar, copy_context
from dataclasses import asdict, dataclass, replace
from difflib import get_close_matches
from functools import partial, wraps
from inspect import signature
from operator import attrgetter
from time import perf_counter
from types import MappingProxyType
from typing import Any, Literal, SupportsIndex, TypeVar, cast

import numpy as np
from sklearn.base import _fit_context as fit_context

from sklearn_raacmm.utils._estimators import Function, warn_user

_LOGGER = logging.getLogger("sklearn_raacmm")

# Of the call that runs: "collected", where findings go instead of being warned of; "accepted",
# codes; "refuses", whether it refuses what has to be repaired, which no part of a call does;
# "ignored", where nobody will read them; "row_numbers", in the user's file, where rows are not
# counted from 0; "stage", which one of a fit it is.
_STATE: ContextVar[Mapping[str, Any]] = ContextVar("state", default=MappingProxyType({}))
# Rows that a finding lists.
_LISTED = 100
# Codes of findings that end a call unless they are accepted: of weight "repair", and the question
# whether an arm is its own mirror image.
TO_ACCEPT = (
    "angle-unit",
    "another-arm",
    "another-frame",
    "axes-of-residuals",
    "corrected-already",
    "joints",
    "mirror-image",
    "moved-position",
    "moved-station",
    "moved-tool",
    "no-such-arm",
    "other-table",
    "places-found",
    "planes-not-parallel",
    "points-of-the-arm",
    "poses-alike",
    "rows-unrelated",
    "shifted-rows",
    "sign-of-residuals",
    "strange-poses",
    "table-off",
    "unit-of-lengths",
    "unit-of-residuals",
    "unit-of-table",
    "weight-of-one-pose",
    "wrong-label",
    "wrong-length",
)

Result = TypeVar("Result")
Weight = Literal["note", "doubt", "repair", "refuse"]


class _Within:
    """Change the state for what runs within.

    It is no generator: one that is interrupted and closed later would change the state of others.
    """

    def __init__(self, **changes: Any) -> None:
        self._changes = changes

    def __enter__(self) -> list["Finding"]:
        self._token = _STATE.set({**_STATE.get(), **self._changes})
        return self._changes.get("collected", [])

    def __exit__(self, *error: object) -> None:
        _STATE.reset(self._token)


@dataclass(frozen=True)
class Finding:
    """What was found in the data, or in what was made of them.

    Attributes
    ----------
    code : str
        Short name of the kind, of small letters and hyphens, such as "moved-position".
    text : str
        One sentence: what was found, with its numbers and units.
    advice : str
        One sentence: what to do. Empty if there is nothing to do.
    weight : {"note", "doubt", "repair", "refuse"}
        "note": good to know. "doubt": results may be worse than they look. "repair": nothing is
        handed over before this is put right, or accepted by its code: then it is a doubt.
        "refuse": these cannot be the data that are asked for; nothing is computed.
    positions : tuple
        Labels of the positions that it is about; empty if it is about all.
    rows : tuple of int
        Rows, counted from 0, or in the command `raacmm` the numbers of their lines in the file; the
        first hundred.
    joints : tuple of int
        Joints, counted from 1.
    size_mm : float or None
        How large it is at the probe, mm.
    """

    code: str
    text: str
    advice: str = ""
    weight: Weight = "doubt"
    positions: tuple[Hashable, ...] = ()
    rows: tuple[int, ...] = ()
    joints: tuple[int, ...] = ()
    size_mm: float | None = None

    def __post_init__(self) -> None:
        # Plain values: findings are saved with models, and written as JSON.
        for name in ("positions", "rows", "joints"):
            values = tuple(getattr(v, "tolist", lambda v=v: v)() for v in getattr(self, name))
            object.__setattr__(self, name, values[:_LISTED])
        if self.size_mm is not None:
            object.__setattr__(self, "size_mm", float(self.size_mm))

    def __str__(self) -> str:
        return f"{self.text} {self.advice}".rstrip()

    def facts(self) -> dict[str, object]:
        """The same as a dictionary that JSON can hold."""
        values = asdict(self)
        return {n: list(v) if isinstance(v, tuple) else v for n, v in values.items()}

    def report(self) -> None:
        """Refuse the data, collect the finding, or warn of it; of a note nobody is warned."""
        state = _STATE.get()
        if self.weight == "repair" and self.code in state.get("accepted", ()):
            return replace(self, weight="doubt").report()
        if self.weight == "repair" and state.get("refuses"):
            # In words that hold for `accept=` and for `--accept`.
            advice = f'{self.advice} Otherwise accept "{self.code}" to go on.'
            raise FindingError(replace(self, advice=advice, weight="refuse"))
        if self.weight == "refuse":
            raise FindingError(self)
        if (collected := state.get("collected")) is not None:
            if self not in collected:
                collected.append(self)
        elif self.weight != "note":
            warn_user(FindingWarning(self))

    @staticmethod
    def numbered(numbers: Sequence[int] | np.ndarray) -> AbstractContextManager[object]:
        """Let findings that are made within name their rows by these numbers (n,).

        Those of the lines of a file, by which whoever reads the findings knows the rows.
        """
        return _Within(row_numbers=numbers)

    @staticmethod
    def row_numbers(rows: Iterable[SupportsIndex]) -> tuple[int, ...]:
        """Numbers by which findings name some rows: counted from 0, or as `numbered` says."""
        numbers = _STATE.get().get("row_numbers")
        return tuple(int(row if numbers is None else numbers[row]) for row in rows)

    @staticmethod
    def collected() -> AbstractContextManager[list["Finding"]]:
        """Collect the findings that are made within, instead of warning.

        ``with Finding.collected() as found`` gives a list, with each finding once; notes, too.
        """
        return _Within(collected=[])

    @staticmethod
    @contextmanager
    def ignored() -> Iterator[None]:
        """Leave out findings and warnings of parts of the data: those of all rows are shown."""
        with _Within(collected=[], ignored=True), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield

    @staticmethod
    def are_ignored() -> bool:
        """Whether nobody will read what is found here, so that it need not be looked for."""
        return bool(_STATE.get().get("ignored"))

    @staticmethod
    def of_call(
        function: Callable[[], Result], accept: str | Sequence[str] | None = None
    ) -> tuple[Result, list["Finding"]]:
        """Call a function: its result, and what was found within, each warned of once at the end.

        A finding of weight "repair" whose code is in `accept` becomes a doubt; any other ends the
        call, unless this is a part of another one, or `accept` is None. In a context of its own:
        whatever interrupts the function, later findings are warned of again.
        """
        codes = Finding.check_accepted(accept)
        before = {**_STATE.get()}
        refuses = accept is not None and before.get("collected") is None
        own = before | {"accepted": (*before.get("accepted", ()), *codes), "refuses": refuses}

        def inside():
            _STATE.set(own)
            found: list[Finding] = []
            try:
                with Finding.collected() as found:
                    result = function()
            except ValueError as error:
                _STATE.set(before | {"accepted": (), "refuses": False})
                # One of them may be the reason; that which is raised is not said twice.
                for finding in found:
                    if finding is not getattr(error, "finding", None):
                        finding.report()
                raise
            for finding in sorted(found, key=lambda one: one.weight == "repair"):
                finding.report()
            return result, found

        return copy_context().run(inside)

    @staticmethod
    def check_accepted(accept: str | Iterable[Any] | None) -> tuple[Any, ...]:
        """Codes to accept; one that no finding to be accepted has is a slip, and refused."""
        codes = (accept,) if isinstance(accept, str) else tuple([] if accept is None else accept)
        for code in codes:
            if code not in TO_ACCEPT:
                near = get_close_matches(str(code), TO_ACCEPT, 3)
                which, those = ("nearest", near) if near else ("codes", TO_ACCEPT)
                raise ValueError(
                    f"accept: {code!r} is no code of a finding that can be accepted. The {which} "
                    f"are: {', '.join(those)}."
                )
        return codes


class FindingWarning(UserWarning):
    """The warning of a finding; ``warning.finding`` is the value."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding)
        self.finding = finding


class FindingError(ValueError):
    """The refusal of data; ``error.finding`` is the value."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding)
        self.finding = finding


def one_warning(function: Function) -> Function:
    """Make a function that warns of each finding once, however many of its parts make it.

    A result that keeps `findings`, or a model that is handed over, has them all.
    """
    takes = "accept" in signature(function).parameters

    @wraps(function)
    def wrapper(*args, **kwargs):
        accept = kwargs.pop("accept", ()) if takes else None
        result, found = Finding.of_call(partial(function, *args, **kwargs), accept)
        if hasattr(result, "findings_"):
            result.findings_ = tuple(found)
        return replace(result, findings=tuple(found)) if hasattr(result, "findings") else result

    return cast(Function, wrapper)


def whole_fit(*, prefer_skip_nested_validation: bool) -> Callable[[Function], Function]:
    """Make a `fit` that leaves the estimator as it was until it is complete, and returns it.

    The parameters are checked before, by scikit-learn; those of inner estimators again unless
    `prefer_skip_nested_validation`.
    The fit works on a shallow copy, and the estimator takes over all attributes of the copy in one
    assignment. Whatever interrupts a refit, an exception or Ctrl-C, leaves the old model whole.
    What is found in the data meanwhile is kept in `findings_`, and reported at the end.
    """

    def decorate(fit: Function) -> Function:
        complete = one_warning(fit)

        @fit_context(prefer_skip_nested_validation=prefer_skip_nested_validation)
        @wraps(fit)
        def wrapper(self, *args, **kwargs):
            aside = object.__new__(type(self))
            aside.__dict__ = vars(self) | {"findings_": ()}
            complete(aside, *args, **kwargs)
            self.__dict__ = aside.__dict__
            return self

        return cast(Function, wrapper)

    return decorate


def stage(name: str, *kept: str) -> Callable[[Function], Function]:
    """Log a line whenever a function, a stage of a fit, has ended: its name, and how long it took.

    The line goes to the logger "sklearn_raacmm" at level INFO:
    ``logging.basicConfig(level=logging.INFO)`` shows it. At level DEBUG a second one has the mean
    and the root mean square of all numbers in the result, the function's name, and the stage that
    it is a part of, whose line follows: where two runs differ first, there one of both differs. Of
    a method that returns nothing these are the numbers of the attributes that it has `kept`.
    """

    def decorate(function: Function) -> Function:
        where = f"{function.__module__}.{function.__qualname__}".removeprefix("sklearn_raacmm.")

        @wraps(function)
        def wrapper(*args, **kwargs):
            start, outer = perf_counter(), _STATE.get().get("stage")
            with _Within(stage=name):
                result = function(*args, **kwargs)
            _LOGGER.info("%s: %.1f s", name, perf_counter() - start)
            if _LOGGER.isEnabledFor(logging.DEBUG):
                found = [attrgetter(part)(args[0]) for part in kept] if kept else result
                values = np.concatenate([np.zeros(0), *_numbers_in(found)])
                values = values[np.isfinite(values)]
                n = max(len(values), 1)
                mean, size = values.sum() / n, np.sqrt(np.square(values).sum() / n)
                by = f"{where}, within {outer}" if outer else where
                text = "%s: %d numbers, mean %.12g, root mean square %.12g, by %s"
                _LOGGER.debug(text, name, len(values), mean, size, by)
            return result

        return cast(Function, wrapper)

    return decorate


def _numbers_in(value: object, depth: int = 4) -> Iterator[np.ndarray]:
    """Yield the numbers of a result, (n,) at a time, those of its parts to some depth."""
    if isinstance(value, float | np.ndarray) and np.asarray(value).dtype.kind in "fi":
        yield np.ravel(value).astype(float)
    elif depth and not isinstance(value, str | type):
        of = value if isinstance(value, dict) else getattr(value, "__dict__", {})
        for part in value if isinstance(value, list | tuple) else of.values():
            yield from _numbers_in(part, depth - 1)
