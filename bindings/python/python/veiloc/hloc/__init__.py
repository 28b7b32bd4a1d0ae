"""The last step of hloc (https://github.com/cvg/Hierarchical-Localization) on what a device would send.

Change `from hloc import localize_sfm` into `from veiloc.hloc import localize_sfm`, and give `scheme="dcl"`. Needs h5py
(`pip install veiloc[hloc]`), and neither hloc nor pycolmap.
"""

from veiloc.hloc import localize_sfm

__all__ = ["localize_sfm"]
