"""What a test generator of the official pipeline sees when `frenetic bench` runs it.

The bench starts ``main.py`` in a process of its own, with any interpreter. There a generator finds
the pipeline's modules, an executor whose time is virtual, and nothing to be adapted to. Like the
plug-in `frenetic.competition`, this package and what it imports of Frenetic need numpy and scipy
only and work on Python 3.9; what hands out shapely objects needs shapely.

| file | holds |
| --- | --- |
| main.py | the process's start: private streams, and `frenetic` made importable |
| session.py | what it does from the first line it is sent to the last it sends |
| messages.py | what it and the bench say to each other |
| parent.py | how it talks to the bench |
| loader.py | finding and building the generator |
| executor.py | the pipeline's executor |
| clock.py | the virtual time |
| offered/ | the pipeline's modules |
"""
