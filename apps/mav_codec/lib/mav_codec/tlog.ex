defmodule MavCodec.Tlog do
  @moduledoc """
  Recordings as ground stations write them (G1): before each frame its time, unix microseconds in 8 bytes, big-endian.

  `MavCodec.Tlog.Reader` reads, `MavCodec.Tlog.Writer` writes.
  """
end
