"""Recipes of the weights that are installed with the aircraft's side. Nothing that is installed imports them.

`python -m training.thermal_things DATA OUT` trains, judges and calibrates the net that finds people, vehicles and other
things in thermal pictures. It needs the pins of `training/requirements.txt` besides the extra `onboard`.
"""
