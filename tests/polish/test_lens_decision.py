"""Which terms of lenses are kept: what the data decide."""

import numpy as np
import pytest

from photoreg.polish.lens_decision import decided_step, let_go, step_back
from photoreg.polish.levenberg_marquardt import Prior, Quadratic


def test_only_what_the_data_decide_is_solved_more():
    old, more = np.eye(3)[:, :2], np.eye(3)
    normal = np.diag([4.0, 4.0, 4.0])
    for gradient, decided in ((2.0, False), (8.0, True)):
        model = Quadratic(1.0, np.array([0.0, 0.0, gradient]), normal)
        step = decided_step(model, normal, old, more)
        assert (step is not None) == decided
        if step is not None:
            assert step == pytest.approx([0.0, 0.0, -2.0])
    assert decided_step(model, normal, more, more) is None


def test_what_the_data_do_not_decide_goes_back():
    few, more = np.eye(3)[:, :2], np.eye(3)
    normal = np.array([[4.0, 0.0, 1.0], [0.0, 4.0, 2.0], [1.0, 2.0, 4.0]])
    model = Quadratic(1.0, np.zeros(3), normal)
    for along, decided in ((1.0, False), (20.0, True)):
        x = np.array([1.0, 1.0, along])
        step = step_back(model, normal, few, more, x)
        assert (step is None) == decided
        if step is not None:
            assert (x + step)[2] == 0.0
            # The others are where they are best without it.
            assert (normal @ step)[:2] == pytest.approx([0.0, 0.0])
    assert step_back(model, normal, more, more, x) is None


def test_a_number_that_its_prior_holds_against_the_data_is_noticed():
    # The third number is 0 by a tight prior; the data want 20 of its units, or none.
    normal = np.diag([4.0, 4.0, 1.0])
    wide = Prior(np.zeros(3), np.diag([1.0, 1.0, 1e-3]))
    for gradient, decided in ((-20.0, True), (-1.0, False)):
        terms = Quadratic(1.0, np.array([0.0, 0.0, gradient]), normal)
        x, groups = np.zeros(3), [np.array([2]), np.array([0, 1])]
        step, far = let_go(terms, normal, x, wide, np.eye(3), groups)
        assert far == [decided, False]
        assert step == pytest.approx([0.0, 0.0, -gradient / 1.001])
    # What does not move is not judged.
    step, far = let_go(terms, normal, x, wide, np.eye(3)[:, :2], groups)
    assert far == [False, False]
