# find_package(veiloc) for CMake: the targets veiloc::veiloc (the shared library) and veiloc::static.
#
#     cmake -Dveiloc_DIR=path/to/cmake -Dveiloc_LIBRARY_DIR=path/to/target/release …
#
# veiloc_LIBRARY_DIR: the folder that cargo wrote libveiloc_c to; for a phone, target/<triple>/release. Default: `lib` beside this
# folder, as in the archive of a release, or target/release of the repository.
cmake_minimum_required(VERSION 3.16)
if(NOT veiloc_LIBRARY_DIR)
  set(veiloc_LIBRARY_DIR "${CMAKE_CURRENT_LIST_DIR}/../lib")
  if(NOT EXISTS "${veiloc_LIBRARY_DIR}")
    set(veiloc_LIBRARY_DIR "${CMAKE_CURRENT_LIST_DIR}/../../../target/release")
  endif()
endif()
get_filename_component(_veiloc_include "${CMAKE_CURRENT_LIST_DIR}/../include" ABSOLUTE)
find_library(veiloc_SHARED veiloc_c PATHS "${veiloc_LIBRARY_DIR}" NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH)
find_file(veiloc_STATIC libveiloc_c.a PATHS "${veiloc_LIBRARY_DIR}" NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH)
if(NOT veiloc_SHARED AND NOT veiloc_STATIC)
  set(veiloc_FOUND FALSE)
  set(veiloc_NOT_FOUND_MESSAGE
      "no libveiloc_c in ${veiloc_LIBRARY_DIR}: cargo build --release -p veiloc-c, and give veiloc_LIBRARY_DIR")
  return()
endif()
if(veiloc_SHARED AND NOT TARGET veiloc::veiloc)
  add_library(veiloc::veiloc UNKNOWN IMPORTED)
  set_target_properties(veiloc::veiloc PROPERTIES IMPORTED_LOCATION "${veiloc_SHARED}"
                        INTERFACE_INCLUDE_DIRECTORIES "${_veiloc_include}")
endif()
if(veiloc_STATIC AND NOT TARGET veiloc::static)
  add_library(veiloc::static STATIC IMPORTED)
  set_target_properties(veiloc::static PROPERTIES IMPORTED_LOCATION "${veiloc_STATIC}"
                        INTERFACE_INCLUDE_DIRECTORIES "${_veiloc_include}")
  if(UNIX)
    find_package(Threads REQUIRED)
    set_property(TARGET veiloc::static PROPERTY INTERFACE_LINK_LIBRARIES Threads::Threads ${CMAKE_DL_LIBS} m)
  endif()
endif()
