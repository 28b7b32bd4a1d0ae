// EXIF made by hand, for tests: a TIFF header and two directories, little endian.

/**
 * The segment of a JPEG file, to be put behind its first two bytes, that gives the focal length in millimetres of 35 mm film, and the
 * orientation.
 */
export function exifSegment(film, orientation = 1) {
  const short = (value) => [value & 255, value >> 8];
  const long = (value) => [...short(value & 65535), ...short(value >>> 16)];
  const field = (tag, kind, value) => [...short(tag), ...short(kind), ...long(1), ...long(value)];
  // No link behind the second directory, as piexif writes it.
  const tiff = [0x49, 0x49, 42, 0, ...long(8), ...short(2), ...field(0x0112, 3, orientation), ...field(0x8769, 4, 38), ...long(0), ...short(1), ...field(0xa405, 3, film)];
  const data = [...new TextEncoder().encode("Exif\0\0"), ...tiff];
  return [0xff, 0xe1, 0, data.length + 2, ...data];
}
