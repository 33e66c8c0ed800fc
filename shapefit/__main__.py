"""`python -m shapefit` is the command `shapefit`."""

if __name__ == "__main__":
    from shapefit.cli.main import main

    main()
