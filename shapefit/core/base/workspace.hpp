// Memory of a kernel: blocks of zeros that live as long as the workspace.
#pragma once

#include <string.h>

#include <new>

#include "views.hpp"
#include "errors.hpp"

namespace shapefit {

class Workspace {
  public:
    Workspace() = default;
    Workspace(const Workspace&) = delete;
    Workspace& operator=(const Workspace&) = delete;
    ~Workspace() {
        while (last_) {
            Block* before = last_->before;
            ::operator delete(last_, std::align_val_t{64});
            last_ = before;
        }
    }

    // `count` zeros, aligned to 64 bytes and followed by a vector's worth of padding.
    template <class T>
    T* zeros(long count) {
        const size_t bytes = (static_cast<size_t>(count) * sizeof(T) + 63) / 64 * 64 + 64;
        Block* block = static_cast<Block*>(
            ::operator new(sizeof(Block) + bytes, std::align_val_t{64}, std::nothrow));
        if (!block) raise_out_of_memory(static_cast<long>(bytes));
        block->before = last_;
        last_ = block;
        ::memset(block + 1, 0, bytes);
        return reinterpret_cast<T*>(block + 1);
    }

    template <class T>
    Vector<T> vector(long n) {
        return {zeros<T>(n), {n}};
    }
    template <class T>
    Matrix<T> matrix(long rows, long columns) {
        return {zeros<T>(rows * columns), {rows, columns}};
    }
    template <class T>
    Tensor<T> tensor(long n, long rows, long columns) {
        return {zeros<T>(n * rows * columns), {n, rows, columns}};
    }

  private:
    struct alignas(64) Block {
        Block* before;
    };
    Block* last_ = nullptr;
};

}  // namespace shapefit
