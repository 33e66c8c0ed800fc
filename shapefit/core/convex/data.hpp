#pragma once

#include "../algebra/views.hpp"
