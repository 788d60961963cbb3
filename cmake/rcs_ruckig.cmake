# Gives the target rcs_ruckig: headers and static library of Ruckig (MIT), which plans motions, without its cloud client.
#
# Looked for in this order: the folder RUCKIG_DIR (CMake or environment), which has include/ruckig and a library in lib or
# lib64, and the Python package `ruckig`.

set(RCS_RUCKIG_HEADER "include/ruckig/ruckig.hpp")

if(NOT RUCKIG_DIR AND DEFINED ENV{RUCKIG_DIR})
  set(RUCKIG_DIR "$ENV{RUCKIG_DIR}")
endif()
if(NOT RUCKIG_DIR)
  find_package(Python 3.11 QUIET COMPONENTS Interpreter)
  if(Python_EXECUTABLE)
    execute_process(COMMAND "${Python_EXECUTABLE}" -c "import sysconfig; print(sysconfig.get_path('platlib'))"
                    OUTPUT_STRIP_TRAILING_WHITESPACE OUTPUT_VARIABLE rcs_platlib)
    if(EXISTS "${rcs_platlib}/${RCS_RUCKIG_HEADER}")
      set(RUCKIG_DIR "${rcs_platlib}")
    endif()
  endif()
endif()
if(NOT EXISTS "${RUCKIG_DIR}/${RCS_RUCKIG_HEADER}")
  message(FATAL_ERROR "Ruckig was not found. Set RUCKIG_DIR to a folder with ${RCS_RUCKIG_HEADER} and lib/libruckig.a, or "
                      "install the Python package ruckig.")
endif()
if(NOT TARGET rcs_ruckig)
  find_library(rcs_ruckig_library NAMES libruckig.a ruckig PATHS "${RUCKIG_DIR}/lib64" "${RUCKIG_DIR}/lib"
               NO_DEFAULT_PATH NO_CACHE REQUIRED)
  add_library(rcs_ruckig UNKNOWN IMPORTED GLOBAL)
  set_target_properties(rcs_ruckig PROPERTIES IMPORTED_LOCATION "${rcs_ruckig_library}"
                                              INTERFACE_INCLUDE_DIRECTORIES "${RUCKIG_DIR}/include")
endif()
