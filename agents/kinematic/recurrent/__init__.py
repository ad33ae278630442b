"""HMD-Poser and LGSIK-Poser."""
