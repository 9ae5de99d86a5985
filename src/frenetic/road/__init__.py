"""What a test is: roads from curvature, their geometry, fitting the map, validity, lanes."""
