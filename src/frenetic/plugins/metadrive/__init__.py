"""MetaDrive as a simulator: Bullet physics, headless, with MetaDrive's own car and drivers.

Nothing here imports the package ``metadrive`` before a simulator starts, so that it need not be
installed.
"""

from frenetic.plugins.metadrive.drivers import MetaDriveExpert, MetaDriveIdm, MetaDrivePolicy
from frenetic.plugins.metadrive.simulator import MetaDriveSimulator

__all__ = ["MetaDriveExpert", "MetaDriveIdm", "MetaDrivePolicy", "MetaDriveSimulator"]
