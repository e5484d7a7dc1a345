// A planner for replan as a program: copy this header. The messages are those of docs/planners_apart.md, as JSON values
// of nlohmann::json; over the wire they are MessagePack, each after 4 bytes of length.
#pragma once

#include <cstdint>
#include <cstring>
#include <exception>
#include <functional>
#include <string>
#include <vector>

#include <unistd.h>

#include <nlohmann/json.hpp>

namespace replan {

using json = nlohmann::json;
using PlanFunction = std::function<json(const json& frame)>;

constexpr int SCHEMA_VERSION = 1;

// The numbers of a column: little-endian float64 (as the machines have it that this is built for).
inline std::vector<double> column(const json& value) {
  const auto& bytes = value.get_binary();
  std::vector<double> numbers(bytes.size() / sizeof(double));
  std::memcpy(numbers.data(), bytes.data(), numbers.size() * sizeof(double));
  return numbers;
}

namespace detail {

inline bool read_all(int fd, char* to, std::size_t size) {
  while (size > 0) {
    const ssize_t came = ::read(fd, to, size);
    if (came <= 0) return false;
    to += came;
    size -= static_cast<std::size_t>(came);
  }
  return true;
}

inline bool write_all(int fd, const std::uint8_t* from, std::size_t size) {
  while (size > 0) {
    const ssize_t sent = ::write(fd, from, size);
    if (sent <= 0) return false;
    from += sent;
    size -= static_cast<std::size_t>(sent);
  }
  return true;
}

inline bool receive(int fd, json& message) {
  std::uint8_t header[4];
  if (!read_all(fd, reinterpret_cast<char*>(header), 4)) return false;
  const std::uint32_t size = header[0] | header[1] << 8 | header[2] << 16 | std::uint32_t(header[3]) << 24;
  std::string payload(size, '\0');
  if (!read_all(fd, payload.data(), size)) return false;
  message = json::from_msgpack(payload);
  return true;
}

inline bool send(int fd, const json& message) {
  const std::vector<std::uint8_t> payload = json::to_msgpack(message);
  const auto size = static_cast<std::uint32_t>(payload.size());
  const std::uint8_t header[4] = {std::uint8_t(size), std::uint8_t(size >> 8), std::uint8_t(size >> 16),
                                  std::uint8_t(size >> 24)};
  return write_all(fd, header, 4) && write_all(fd, payload.data(), payload.size());
}

}  // namespace detail

// One drive over stdin and stdout. `build` is given the hello message (road, goal, vehicle, origin, settings) and
// returns what answers a frame message with a plan message; what either throws ends the drive, and its text is shown to
// the user. What is printed goes to stderr.
inline int serve(const std::function<PlanFunction(const json& hello)>& build) {
  const int in = ::dup(0), out = ::dup(1);
  ::dup2(2, 1);
  PlanFunction plan;
  for (json message; detail::receive(in, message);) {
    json answer;
    try {
      if (message.at("type") == "frame") {
        answer = plan(message);
        answer["type"] = "plan";
      } else if (message.at("schema") != SCHEMA_VERSION) {
        answer = {{"type", "failed"}, {"message", "this version of the messages is not known"}};
      } else {
        plan = build(message);
        answer = {{"type", "ready"}, {"schema", SCHEMA_VERSION}};
      }
    } catch (const std::exception& error) {
      answer = {{"type", "failed"}, {"message", error.what()}};
    }
    if (!detail::send(out, answer)) return 1;
  }
  return 0;
}

}  // namespace replan
