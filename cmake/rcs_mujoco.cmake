# Gives the target mujoco::mujoco: for the build, and beside the installed rcsConfig.cmake for those who use it.
#
# Looked for in this order: a target of that name, the folder MUJOCO_DIR (CMake or environment), CMake's package `mujoco`,
# and the Python package `mujoco-core`. With bindings it is always the last, so that C++ and Python share one engine.

set(RCS_MUJOCO_VERSION 4000000)  # mjVERSION_HEADER; structures differ between versions

function(rcs_mujoco_of_python result)
  set(${result} "" PARENT_SCOPE)
  find_package(Python 3.11 QUIET COMPONENTS Interpreter)
  if(Python_EXECUTABLE)
    execute_process(
      COMMAND "${Python_EXECUTABLE}" -c
              "import importlib.util as u; s = u.find_spec('mujoco'); print(s.submodule_search_locations[0] if s else '')"
      OUTPUT_STRIP_TRAILING_WHITESPACE OUTPUT_VARIABLE folder)
    set(${result} "${folder}" PARENT_SCOPE)
  endif()
endfunction()

# An official release has lib/, the Python package has its library beside include/.
function(rcs_add_mujoco folder)
  file(GLOB libraries "${folder}/lib/libmujoco.so" "${folder}/lib/libmujoco.so.*" "${folder}/libmujoco.so.*"
       "${folder}/lib/libmujoco.*.dylib" "${folder}/libmujoco.*.dylib")
  if(NOT libraries OR NOT EXISTS "${folder}/include/mujoco/mujoco.h")
    message(FATAL_ERROR "There is no MuJoCo in '${folder}': it needs include/mujoco/mujoco.h and libmujoco.")
  endif()
  list(GET libraries 0 library)
  add_library(mujoco::mujoco SHARED IMPORTED GLOBAL)
  set_target_properties(mujoco::mujoco PROPERTIES IMPORTED_LOCATION "${library}"
                                                  INTERFACE_INCLUDE_DIRECTORIES "${folder}/include")
endfunction()

if(NOT MUJOCO_DIR AND DEFINED ENV{MUJOCO_DIR})
  set(MUJOCO_DIR "$ENV{MUJOCO_DIR}")
endif()
if(RCS_BUILD_PYTHON)
  rcs_mujoco_of_python(MUJOCO_DIR)
endif()
if(NOT TARGET mujoco::mujoco AND NOT MUJOCO_DIR)
  find_package(mujoco CONFIG QUIET)
  if(TARGET mujoco::mujoco)
    set_target_properties(mujoco::mujoco PROPERTIES IMPORTED_GLOBAL TRUE)
  else()
    rcs_mujoco_of_python(MUJOCO_DIR)
    if(NOT MUJOCO_DIR)
      message(FATAL_ERROR "MuJoCo was not found. Set MUJOCO_DIR to the folder of a release of it, or mujoco_DIR to that of "
                          "its mujocoConfig.cmake, or install the Python package mujoco-core.")
    endif()
  endif()
endif()
if(NOT TARGET mujoco::mujoco)
  rcs_add_mujoco("${MUJOCO_DIR}")
endif()

get_target_property(rcs_mujoco_include mujoco::mujoco INTERFACE_INCLUDE_DIRECTORIES)
foreach(folder ${rcs_mujoco_include})
  if(EXISTS "${folder}/mujoco/mujoco.h")
    file(STRINGS "${folder}/mujoco/mujoco.h" rcs_mujoco_found REGEX "define mjVERSION_HEADER")
    if(NOT rcs_mujoco_found MATCHES "${RCS_MUJOCO_VERSION}")
      message(FATAL_ERROR "rcs needs MuJoCo ${RCS_MUJOCO_VERSION}; '${folder}' has '${rcs_mujoco_found}'.")
    endif()
  endif()
endforeach()
