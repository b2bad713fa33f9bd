/* What the sources that this library was built from are told apart from others by. */
#include "core.h"

const char *tc_sources(void) { return TENSCONTROL_SOURCES; }
