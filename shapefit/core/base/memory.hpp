// Views of row-major arrays that Python owns, a pointer and the sizes, and memory of a
// kernel.
#pragma once

#include <stdint.h>
#include <stdlib.h>

#include <type_traits>

#include "index.hpp"

namespace shapefit {

// An array of Python's: the address of its first element, and the size of each axis.
template <class T, int rank>
struct View {
    T* data = nullptr;
    Index size[rank] = {};

    // Entry i along the first axis, an array of the other axes.
    View<T, rank - 1> operator[](Index i) const {
        View<T, rank - 1> part;
        Index stride = 1;
        for (int d = 1; d < rank; ++d) {
            part.size[d - 1] = size[d];
            stride *= size[d];
        }
        part.data = data + i * stride;
        return part;
    }
    // This array, for those who only read it.
    operator View<const T, rank>() const
        requires(!std::is_const_v<T>)
    {
        View<const T, rank> same;
        same.data = data;
        for (int d = 0; d < rank; ++d) same.size[d] = size[d];
        return same;
    }
};

template <class T>
struct View<T, 1> {
    T* data = nullptr;
    Index size[1] = {};

    T& operator[](Index i) const { return data[i]; }
    operator View<const T, 1>() const
        requires(!std::is_const_v<T>)
    {
        return {data, {size[0]}};
    }
};

template <class T>
using Vector = View<T, 1>;
template <class T>
using Matrix = View<T, 2>;
template <class T>
using Tensor = View<T, 3>;
template <class T>
using Blocks = View<T, 4>;

// Images first <= image < last of a batch: whole blocks, but for the end of the batch.
struct Range {
    Index first = 0;
    Index last = 0;
};

// Images of one block, so many at most, may start from one another's solutions; each
// block starts afresh. This length is fixed, so that no result depends on the number of
// threads, nor on how a file is cut into batches of whole blocks.
constexpr Index IMAGES_PER_BLOCK = 64;

// Throw std::bad_alloc where `bytes` could not be allocated; bind/module.cpp defines
// it, outside the code of any instruction set.
[[noreturn]] void raise_out_of_memory(Index bytes);

// Throw where the program has been asked to end, which ends the call of the kernel.
// Every loop that may take long calls this once a step; it costs as much as reading the
// clock.
void check_interrupt();

// Memory of one call of a kernel: arrays of zeros, which are freed with the workspace.
class Workspace {
  public:
    Workspace() = default;
    Workspace(const Workspace&) = delete;
    Workspace& operator=(const Workspace&) = delete;
    ~Workspace() {
        while (last_) {
            Block* before = last_->before;
            ::free(last_->memory);
            last_ = before;
        }
    }

    // Allocate `count` zeros, aligned to 64 bytes and followed by 64 bytes of padding.
    template <class T>
    T* zeros(Index count) {
        const size_t bytes =
            (static_cast<size_t>(count) * sizeof(T) + 63) / 64 * 64 + 64;
        // calloc: pages that nobody touches cost nothing
        void* memory = ::calloc(1, sizeof(Block) + bytes + 64);
        if (!memory) raise_out_of_memory(static_cast<Index>(bytes));
        const uintptr_t address = reinterpret_cast<uintptr_t>(memory);
        Block* block = reinterpret_cast<Block*>((address + 63) / 64 * 64);
        block->before = last_;
        block->memory = memory;
        last_ = block;
        return reinterpret_cast<T*>(block + 1);
    }

    // Allocate arrays of zeros of these sizes.
    template <class T>
    Vector<T> vector(Index n) {
        return {zeros<T>(n), {n}};
    }
    template <class T>
    Matrix<T> matrix(Index rows, Index columns) {
        return {zeros<T>(rows * columns), {rows, columns}};
    }
    template <class T>
    Tensor<T> tensor(Index n, Index rows, Index columns) {
        return {zeros<T>(n * rows * columns), {n, rows, columns}};
    }

  private:
    struct alignas(64) Block {
        Block* before;
        void* memory;  // as it was given, not aligned
    };
    Block* last_ = nullptr;
};

}  // namespace shapefit
