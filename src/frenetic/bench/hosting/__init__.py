"""The environment of a test generator of the official pipeline under `frenetic bench`.

The bench starts ``main.py`` in its own process, with any interpreter. There a generator finds the
pipeline's modules and an executor whose time is virtual, and runs unmodified. The modules are those
of the clone of the pipeline that holds the generator, which need shapely and matplotlib; for a lone
file there are stand-ins. This package and what it imports of Frenetic need numpy 1.21 and scipy
only and work on Python 3.9.

| file | holds |
| --- | --- |
| main.py | the process's start: private streams, and `frenetic` made importable |
| host.py | what it does from the first line it is sent to the last it sends |
| messages.py | what it and the bench say to each other, and how it says it |
| pipeline.py | finding the pipeline's modules |
| executor.py | the pipeline's executor with the bench behind it, and its virtual time |
| validity.py | the rules of road tests, imported when they are needed |
| standins/ | the pipeline's modules for a lone file |
| adapters/ | what gives RILaST their interface |
"""
