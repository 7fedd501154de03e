"""Plans for the tip on the rig: speeds, learning with a wrong plant, moves from rest to rest."""
