"""The commands, a file each: `main(args)` runs `taichi-nmm NAME`; see `study/cli.py`."""
