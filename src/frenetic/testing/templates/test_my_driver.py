"""The tests of my_driver.py: run them with pytest."""

from my_driver import MyDriver

from frenetic import EmbeddedSimulator, Outcome, Road, judge
from frenetic.testing import DriverContract


class TestContract(DriverContract):
    """It gives valid controls on every road, and drives the same road in the same way."""

    def make(self) -> MyDriver:
        """Return the driver as it is to be tested."""
        return MyDriver()


def test_a_gentle_bend_is_no_problem() -> None:
    """Curvatures are 1/m, one every 10 m."""
    road = Road([0.0, 0.0, 0.01, 0.02, 0.02, 0.01, 0.0, 0.0])
    result = judge(road, EmbeddedSimulator().drive(road, MyDriver()))
    assert result.outcome is Outcome.PASS, result.reason
