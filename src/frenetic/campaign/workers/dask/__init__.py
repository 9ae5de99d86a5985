"""Workers of a Dask cluster, on this machine and others."""
