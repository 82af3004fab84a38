defmodule MavCodec.Meaning.HighLatency do
  @moduledoc """
  What links of high latency carry: satellite modems and the like, where bytes cost money and minutes (X6). Commands and their
  answers go over them; heartbeats, streams, parameters, missions and clock measurements do not.
  """

  alias MavCodec.MessageId
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Frame

  @silent_us 10_000_000
  @commands Enum.map(~w(COMMAND_INT COMMAND_LONG), &MessageId.of!/1)
  @carried @commands ++
             Enum.map(
               ~w(SET_MODE MISSION_SET_CURRENT COMMAND_ACK COMMAND_CANCEL HIGH_LATENCY HIGH_LATENCY2),
               &MessageId.of!/1
             )
  # Commands that only ask for more to be sent.
  @asking Enum.map(
            [:MAV_CMD_GET_MESSAGE_INTERVAL, :MAV_CMD_SET_MESSAGE_INTERVAL, :MAV_CMD_REQUEST_MESSAGE],
            &MavCmd.value/1
          )

  @doc "Microseconds after the last heartbeat from which a HIGH_LATENCY2 means that no more heartbeats come by the link."
  @spec silent_us() :: pos_integer()
  def silent_us, do: @silent_us

  @doc "Whether a link of high latency carries a frame."
  @spec carries?(Frame.t()) :: boolean()
  def carries?(%Frame{id: id, payload: <<_params::28-binary, command::16-little, _::binary>>})
      when id in @commands,
      do: command not in @asking

  def carries?(%Frame{id: id}), do: id in @carried
end
