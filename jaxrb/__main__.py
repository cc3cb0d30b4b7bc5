"""`python -m jaxrb`: the command line where its script is not on the path."""

from jaxrb.cli import main

if __name__ == "__main__":
    main()
