"""Arrays in, arrays out: the numerical ground floor, which knows no noun of the package."""
