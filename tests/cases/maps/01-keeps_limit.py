"""A driver that keeps the speed limit and steers for a point on the lane's middle."""

from frenetic import Controls, DriveSetup, Observation


class Limit:
    def reset(self, setup: DriveSetup) -> None:
        self.wheelbase = setup.wheelbase
        self.limit = setup.speed_limit  # m/s

    def act(self, observation: Observation) -> Controls:
        x, y = observation.ahead[4]
        steering = 2 * self.wheelbase * y / (x * x + y * y)
        return Controls(
            steering,
            throttle=0.3 if observation.speed < self.limit else 0.0,
            brake=0.2 if observation.speed > self.limit + 0.5 else 0.0,
        )
