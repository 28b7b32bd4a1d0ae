//! The map model, its file format, and the import of COLMAP models.
