"""Intervals and tests of significance, against published values and cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.evaluation.intervals import Share, bootstrap_mean, mcnemar, wilson


def test_wilson_interval_has_its_published_values() -> None:
    """81 of 263 and 15 of 148: R. G. Newcombe, Two-sided confidence intervals for the single proportion, 1998."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(20, 20) == pytest.approx((0.8389, 1.0), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="passed must be within 0 and whole = 3, got 4"):
        wilson(4, 3)


def test_a_share_of_nothing_has_no_value() -> None:
    assert Share(0, 0).value is None and Share(3, 4).value == 0.75


def test_bootstrap_covers_the_mean_and_narrows_with_more_values() -> None:
    rng = np.random.default_rng(0)
    few, many = rng.normal(2.0, 1.0, 25), rng.normal(2.0, 1.0, 2500)
    mean = bootstrap_mean([few])
    assert mean is not None and mean.low is not None and mean.high is not None
    assert mean.value == pytest.approx(few.mean()) and mean.low < mean.value < mean.high
    # of the normal distribution: 1.96 standard errors to each side
    assert mean.high - mean.low == pytest.approx(2 * 1.96 * few.std() / 5.0, rel=0.1)
    wide = bootstrap_mean([many])
    assert wide is not None and wide.high - wide.low < 0.2 * (mean.high - mean.low)
    assert bootstrap_mean([few]) == mean  # seeded


def test_differences_between_scenarios_are_no_uncertainty() -> None:
    """Each scenario is resampled within itself, so one that always gives the same value adds nothing."""
    mean = bootstrap_mean([[1.0, 1.0, 1.0], [5.0, 5.0, 5.0]])
    assert mean is not None and (mean.value, mean.low, mean.high, mean.count) == (3.0, 3.0, 3.0, 6)


def test_one_repeat_tells_nothing_about_its_spread() -> None:
    mean = bootstrap_mean([[1.0], [2.0], []])
    assert mean is not None and (mean.value, mean.low, mean.high) == (1.5, None, None)
    assert bootstrap_mean([[], []]) is None


def test_mcnemar_is_the_binomial_test() -> None:
    assert mcnemar(0, 0) == 1.0
    assert mcnemar(5, 5) == 1.0
    assert mcnemar(0, 5) == pytest.approx(2 / 2**5)
    assert mcnemar(1, 9) == mcnemar(9, 1) == pytest.approx(2 * (1 + 10) / 2**10)
    assert mcnemar(900, 1100) == pytest.approx(8.6e-6, rel=0.05)  # beyond the range of 2.0**n
