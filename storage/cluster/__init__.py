"""Work spread over a Dask cluster: a scheduler that runs already, or processes of this machine.

`session` connects to it, and `worker` is what a session puts on its workers. Both need the package
distributed, an extra; `storage.pool.open_pool` imports them when a cluster is asked for.
"""
