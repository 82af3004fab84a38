defmodule Aerie.Vehicle.Services.Streams.Intercept do
  @moduledoc """
  Decides what happens to a client's own request for a message rate. Pure.

  A rate belongs to the link, so the last request wins (M2), and one client's request could lower another client's rate. A
  request that lowers no other client's rate is forwarded, and the vehicle itself answers. One that would is recorded and
  answered in the vehicle's name. REQUEST_DATA_STREAM is always recorded and never forwarded: it sets whole groups, has no
  answer, and some programs repeat it every few seconds. `Aerie.Vehicle.Services.Streams.Arbiter` requests the group once, then
  restores the higher rates in it, and resets the group when its clients are gone.
  """

  alias Aerie.Vehicle.Services.Streams.{Arbiter, Request}
  alias MavCodec.Frame
  alias MavCodec.Messages.{CommandAck, CommandInt, CommandLong, RequestDataStream}

  @command_int CommandInt.id()
  @command_long CommandLong.id()
  @request_data_stream RequestDataStream.id()
  @set_message_interval MavCodec.Enums.MavCmd.value(:MAV_CMD_SET_MESSAGE_INTERVAL)
  # For the gateway itself this rate is enough.
  @floor_hz 0.5

  @type verdict ::
          :pass
          | {:forward | :absorb,
             demand ::
               Aerie.Vehicle.Services.StreamDemand.what() | [Aerie.Vehicle.Services.StreamDemand.what()],
             hz :: number() | nil}

  @doc """
  Whether a frame requests a rate, by its id and two bytes of its payload, so that other frames need not be decoded.
  """
  @spec request?(Frame.t()) :: boolean()
  def request?(%Frame{id: @request_data_stream}), do: true

  def request?(%Frame{id: id, payload: <<_params::28-binary, @set_message_interval::16-little, _::binary>>})
      when id in [@command_long, @command_int],
      do: true

  def request?(_frame), do: false

  @doc """
  What to do with a message, given what all other clients want (`Aerie.Vehicle.Services.StreamDemand.merged/3`): `:pass` if it requests
  no rate, else `{:forward, what, hz}` or `{:absorb, what, hz}` with the client's demand, `hz` nil if it withdraws it.
  """
  @spec decide(struct(), Aerie.Vehicle.Services.StreamDemand.merged()) :: verdict()
  def decide(message, others) do
    case Request.read(message) do
      {:message, id, hz} -> {if((hz || 0) >= least(id, others), do: :forward, else: :absorb), id, hz}
      {:groups, groups, hz} -> {:absorb, Enum.map(groups, &{:group, &1}), hz}
      :other -> :pass
    end
  end

  # The lowest rate that takes nothing from the others.
  defp least(id, others) do
    floor = if is_map_key(Arbiter.floor(), id), do: @floor_hz, else: 0
    group = Map.get(others.groups, Request.group(id), 0)
    Enum.max([floor, group, Map.get(others.messages, id, 0)])
  end

  @doc "The answer to an absorbed request in the vehicle's name; nil if the request has none."
  @spec answer(Frame.t(), component :: 0..255, result :: 0..255) :: binary() | nil
  def answer(%Frame{id: id, version: version} = frame, component, result)
      when id in [@command_long, @command_int] do
    {system, _target} = MavCodec.Frame.target(frame)

    ack = %CommandAck{
      command: @set_message_interval,
      result: result,
      target_system: frame.system,
      target_component: frame.component
    }

    # A sender or vehicle whose own id is above 255 understands such ids (N1).
    sysid32? = max(system, frame.system) > 255
    options = [system: system, component: component, seq: frame.seq, version: version, sysid32: sysid32?]
    MavCodec.encode(ack, options)
  end

  def answer(_frame, _component, _result), do: nil
end
