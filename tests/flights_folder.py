"""Where the workers of one run keep the flights that they share."""

FLIGHTS_VARIABLE = "POINTCLICK_TEST_FLIGHTS"
