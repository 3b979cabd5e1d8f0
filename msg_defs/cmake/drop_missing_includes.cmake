# SPDX-License-Identifier: BSD-3-Clause
# Only for ROS 2 from wheels (the Makefile passes it as CMAKE_PROJECT_INCLUDE); an apt installation does not need it.
# The wheels' CMake exports name include directories of the machine that built them, and CMake refuses imported
# targets whose directories do not exist. Deferred to the end of the directory, when all find_package() have run.

function(drop_missing_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(kept "")
    foreach(directory IN LISTS directories)
      # Generator expressions ($<...>) are relative for CMake and stay.
      if(NOT IS_ABSOLUTE "${directory}" OR EXISTS "${directory}")
        list(APPEND kept "${directory}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()

cmake_language(DEFER CALL drop_missing_includes)
