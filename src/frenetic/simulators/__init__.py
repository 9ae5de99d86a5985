"""What moves the car: the Simulator protocol and the simulators that implement it."""
