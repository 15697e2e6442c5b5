"""`taichi-nmm sweep`, from a checkout."""

from checkout import run

if __name__ == "__main__":
    run("sweep")
