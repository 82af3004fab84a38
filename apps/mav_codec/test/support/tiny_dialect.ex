defmodule MavCodec.Test.TinyDialect do
  @moduledoc "A dialect of a handful of real messages, for tests of the wire that need to know what is in it."

  # HEARTBEAT, SYS_STATUS, ATTITUDE, COMMAND_LONG, STATUSTEXT, SETUP_SIGNING
  @extras %{0 => 50, 1 => 124, 30 => 39, 76 => 152, 253 => 83, 256 => 71}

  def crc_extra(id), do: Map.get(@extras, id)
  def ids, do: Map.keys(@extras)
end
