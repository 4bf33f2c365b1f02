"""``envcraft audit --executor dask``: environments are judged by the workers of a Dask cluster."""
