"""Who does long work: processes of this machine or a Dask cluster, handed out in batches."""
