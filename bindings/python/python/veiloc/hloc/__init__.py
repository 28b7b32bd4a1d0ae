"""The last step of hloc (https://github.com/cvg/Hierarchical-Localization), on obfuscated keypoints.

Replace `from hloc import localize_sfm` by `from veiloc.hloc import localize_sfm`, and pass `scheme="dcl"`. Needs h5py
(`pip install veiloc[hloc]`), but neither hloc nor pycolmap.
"""

from veiloc.hloc import localize_sfm

__all__ = ["localize_sfm"]
