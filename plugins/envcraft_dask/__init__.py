"""The executor ``dask``: judges environments on the workers of a Dask cluster."""
