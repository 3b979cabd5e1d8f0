# SPDX-License-Identifier: BSD-3-Clause
"""Motors of the virtual robot that lead by what com/planned_deflection says."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.core.base.types import JointMessage
from coman_reduced_model.core.streams.stream import Refused
from coman_reduced_model.ros.nodes.planned_lead import PlannedLead


def test_a_lead_that_comes_late_or_not_at_all():
    lead = PlannedLead(("a", "b"))
    links, own = np.array([1.0, 2.0]), np.array([1.1, 2.1])
    assert (lead.motors(0, 0.02, links, own) == own).all() and lead.share == 0.0
    for k in range(3):  # deflections that grow in a line; of a joint that the robot lacks as well
        lead.add(JointMessage(k * 10_000_000, ("b", "c"), np.array([0.1 * k, 0.5]), None, None))
    for _ in range(60):
        motors = lead.motors(40_000_000, 0.02, links, own)
    assert lead.share == 1.0 and motors == pytest.approx([1.0, 2.0 - 0.4])  # 20 ms late: continued
    motors = lead.motors(100_000_000, 0.1, links, own)
    assert lead.share == pytest.approx(0.8) and motors[1] == pytest.approx(2.1 - 0.8 * 0.5)  # fades
    for names, values in ((("a",), [1.0, 2.0]), (("a",), [np.nan]), (("a",), [3.0])):
        with pytest.raises(Refused):
            lead.add(JointMessage(1, names, np.array(values), None, None))
