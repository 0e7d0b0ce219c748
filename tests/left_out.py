"""How a test says that it left itself out: the run's end names it, loudly."""

LEFT_OUT = "left out: no recordings at"
NO_PROGRAM = "left out: no program"
NO_TIME = "left out: no time in this run; make test-long ALL=1"
