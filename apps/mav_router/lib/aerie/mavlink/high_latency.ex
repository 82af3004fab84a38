defmodule Aerie.Mavlink.HighLatency do
  @moduledoc """
  What goes over links of high latency: satellite modems and the like, where a byte costs money and minutes (X6). Commands
  and their answers do; heartbeats, streams, parameters, missions and clock measurements do not.
  """

  alias MavCodec.Frame

  # HIGH_LATENCY2 without a heartbeat for this long: that is all that comes by this link.
  @silent_us 10_000_000
  # SET_MODE, MISSION_SET_CURRENT, COMMAND_INT, COMMAND_LONG, COMMAND_ACK, COMMAND_CANCEL, HIGH_LATENCY, HIGH_LATENCY2
  @carried [11, 41, 75, 76, 77, 80, 234, 235]
  # … except those commands that only ask for more to be sent.
  @asking [510, 511, 512]

  @doc "How long after the last heartbeat a summary means that no more heartbeats come (us)."
  @spec silent_us() :: pos_integer()
  def silent_us, do: @silent_us

  @doc "Whether a frame may go over a link of high latency: for routers, which ask for each frame."
  @spec carries?(Frame.t()) :: boolean()
  def carries?(%Frame{id: id, payload: <<_params::28-binary, command::16-little, _::binary>>})
      when id in [75, 76],
      do: command not in @asking

  def carries?(%Frame{id: id}), do: id in @carried
end
