"""Work spread over a Dask cluster: a scheduler that runs already, or processes of this machine.

`asked` says what a user asks for and `opening` opens it, both without Dask. `connection` makes the
pool that commands are given in place of a local one, `plugin` is what it puts on workers, `gate`
lets in those of the folder's kind, `executor` passes calls on, `freight` carries stores, and `deaf`
keeps Ctrl-C from workers of this machine. These need the package distributed, an extra.
"""
