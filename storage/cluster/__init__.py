"""Work spread over a Dask cluster: a scheduler that runs already, or processes of this machine.

`connection` makes the pool that commands are given in place of a local one; `plugin` is what it
puts on workers; `kind` is what a worker computes with, `gate` lets in those that compute the
folder's bits, `executor` passes calls on, `freight` carries stores. All of them need the package
distributed, an extra; `asked` says what a user asks for, and needs nothing.
"""
