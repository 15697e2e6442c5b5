"""`taichi-nmm study`, from a checkout."""

from checkout import run

if __name__ == "__main__":
    run("study")
