"""Workers on a Dask cluster, see `frenetic.plugins.dask.cluster`."""
