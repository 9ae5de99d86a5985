"""A plug-in: drivers with a camera, the pictures that it takes, neural networks and policies."""
