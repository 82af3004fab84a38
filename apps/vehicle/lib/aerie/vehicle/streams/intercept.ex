defmodule Aerie.Vehicle.Streams.Intercept do
  @moduledoc """
  What becomes of a client's own request for a rate on its way to a vehicle. Pure.

  The rate belongs to the link, so the last request wins (M2), and one client's request would take another's rate away. A
  request that takes nothing from anybody is forwarded as it is: the vehicle itself answers. One that would lower what
  somebody else wants is noted and answered in the vehicle's name. REQUEST_DATA_STREAM is always noted and not forwarded: it
  sets whole groups, some programs repeat it every few seconds, and it has no answer; `Aerie.Vehicle.Streams.Arbiter` asks
  for the group once, and gives those in it that are to come more often their rate back.
  """

  alias Aerie.Vehicle.Streams.{Arbiter, Request}
  alias MavCodec.Frame
  alias MavCodec.Messages.CommandAck

  @command_int 75
  @command_long 76
  @request_data_stream 66
  @set_message_interval 511
  # The gateway's own wants need no more than this.
  @floor_hz 0.5

  @type verdict ::
          :pass
          | {:forward | :absorb, want :: Aerie.Fleet.Wants.what() | [Aerie.Fleet.Wants.what()],
             hz :: number() | nil}

  @doc """
  Whether a frame is a request for a rate, told by its id and a glance at its payload: what is not one need not be decoded.
  """
  @spec request?(Frame.t()) :: boolean()
  def request?(%Frame{id: @request_data_stream}), do: true

  def request?(%Frame{id: id, payload: <<_params::28-binary, @set_message_interval::16-little, _::binary>>})
      when id in [@command_long, @command_int],
      do: true

  def request?(_frame), do: false

  @doc """
  What to do with a message, given what all others want (`Aerie.Fleet.Wants.merged/3`): `:pass` when it is no request for
  a rate, `{:forward, what, hz}` and `{:absorb, what, hz}` with the want that is to be noted for the client, `hz` nil when
  it takes its want back.
  """
  @spec decide(struct(), Aerie.Fleet.Wants.merged()) :: verdict()
  def decide(message, others) do
    case Request.read(message) do
      {:message, id, hz} -> {if((hz || 0) >= least(id, others), do: :forward, else: :absorb), id, hz}
      {:groups, groups, hz} -> {:absorb, Enum.map(groups, &{:group, &1}), hz}
      :other -> :pass
    end
  end

  # What the others would lose by less.
  defp least(id, others) do
    floor = if is_map_key(Arbiter.floor(), id), do: @floor_hz, else: 0
    group = Map.get(others.groups, Request.group(id), 0)
    Enum.max([floor, group, Map.get(others.messages, id, 0)])
  end

  @doc "The vehicle's answer to a request that was absorbed, for who sent it; nil when there is none."
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

    # Of whoever has an id of more than a byte was heard, so such ids are understood (N1).
    long? = max(system, frame.system) > 255
    options = [system: system, component: component, seq: frame.seq, version: version, sysid32: long?]
    MavCodec.encode(ack, options)
  end

  def answer(_frame, _component, _result), do: nil
end
