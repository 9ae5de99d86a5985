"""Stand-in for the pipeline's package; a partial copy on the module path adds its other modules."""

from pkgutil import extend_path

__path__ = extend_path(__path__, __name__)
