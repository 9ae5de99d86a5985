"""A plug-in: drivers that see through a camera, what they see, and Gymnasium."""
