# SPDX-License-Identifier: Apache-2.0
# Only for the ROS wheels of PyPI, passed as CMAKE_PROJECT_worm_msgs_INCLUDE by ./worm build.
#
# The Python targets that those wheels export name include folders of the machine that built the
# wheels. CMake rejects a target whose include folder does not exist. CMake finds this machine's
# Python and NumPy and does not need these folders, so this file drops folders that do not exist.

cmake_policy(SET CMP0057 NEW)
find_package(ament_cmake REQUIRED)
foreach(package action_msgs builtin_interfaces rosidl_default_runtime service_msgs std_msgs
    unique_identifier_msgs)
  find_package(${package} REQUIRED)
endforeach()

get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
foreach(target IN LISTS targets)
  get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
  if(NOT folders)
    continue()
  endif()
  set(existing "")
  foreach(folder IN LISTS folders)
    if(folder MATCHES "\\$<" OR EXISTS "${folder}")
      list(APPEND existing "${folder}")
    endif()
  endforeach()
  set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${existing}")
endforeach()

# Only Python programs use these interfaces: C++ types would take a third of the time of the build.
find_package(rosidl_default_generators REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
