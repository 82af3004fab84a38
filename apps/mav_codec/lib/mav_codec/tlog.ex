defmodule MavCodec.Tlog do
  @moduledoc """
  Recordings in the format of ground stations (G1): before each frame its time, unix microseconds in 8 bytes, big-endian.

  `MavCodec.Tlog.Reader` reads, `MavCodec.Tlog.Writer` writes.
  """
end
