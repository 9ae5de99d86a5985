"""The environment of a test generator of the official pipeline under `frenetic bench`.

The bench starts ``main.py`` in its own process, with any interpreter. There a generator finds the
pipeline's modules and an executor whose time is virtual, and runs unmodified. This package and what
it imports of Frenetic need numpy 1.21 and scipy only and work on Python 3.9; functions that return
shapely objects need shapely.

| file | holds |
| --- | --- |
| main.py | the process's start: private streams, and `frenetic` made importable |
| session.py | what it does from the first line it is sent to the last it sends |
| messages.py | what it and the bench say to each other, and how it says it |
| loader.py | finding and building the generator |
| executor.py | the pipeline's executor and its virtual time |
| validity.py | the rules of road tests, imported when they are needed |
| offered/ | the pipeline's modules, and what gives RILaST their interface |
"""
