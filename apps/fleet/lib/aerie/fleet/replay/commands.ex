defmodule Aerie.Fleet.Replay.Commands do
  @moduledoc """
  The commands in a recording, each with the vehicle as it was at that moment: a pure value over `Aerie.Fleet.Replay.Machine`.

  A command is what the router's gate would ask the policy about (`MavRouter.Forward.Gate`): an order, or a pilot's
  stick, of somebody who is not a vehicle. A recording tells the ids of its sender and not the endpoint, and has only
  what was sent to the vehicle: what a gateway refused then is missing. A frame that two links sent, or that two
  recordings have, counts once. What cannot be judged is counted by its reason (`t:skipped/0`).
  """

  alias Aerie.Fleet.Replay.Machine
  alias MavCodec.Meaning.Messages
  alias MavCodec.{Command, Frame}
  alias MavCodec.Frame.Splitter
  alias MavCodec.Dialects.All

  @enforce_keys [:machine]
  defstruct [:machine, sent: %{}, skipped: %{}]

  # A number of a sender comes again after 256 frames.
  @copy_us 1_000_000
  @max_sent 100_000

  @typedoc """
    * `:unheard` - to a vehicle of which nothing was heard before
    * `:vehicle` - of one vehicle to another one
    * `:unknown` - messages that no table knows; `:unreadable` - that cannot be decoded
    * `:never` - messages that nobody's go to a vehicle
    * `:copy` - seen before
  """
  @type reason :: :unheard | :vehicle | :unknown | :unreadable | :never | :copy
  @type skipped :: %{reason() => pos_integer()}

  @type t :: %__MODULE__{machine: Machine.t(), sent: %{integer() => integer()}, skipped: skipped()}

  @typedoc "`:own?` - it has the gateway's own ids; `:class` - of the message (`MavCodec.Meaning.Messages`); `:snapshot` - of its vehicle, just before."
  @type found :: %{
          at: integer(),
          from: {system :: non_neg_integer(), component :: byte()},
          own?: boolean(),
          class: Messages.class(),
          name: String.t(),
          message: struct(),
          snapshot: map()
        }

  @doc "Nothing was heard."
  @spec new(Machine.t()) :: t()
  def new(machine), do: %__MODULE__{machine: machine}

  @doc "Another recording, whose vehicles begin with nothing known. What was counted stays, and so do the frames by which copies are found."
  @spec again(t(), Machine.t()) :: t()
  def again(commands, machine), do: %{commands | machine: machine}

  @doc "The next frame or damaged part of a recording, and the commands that it is: one for each vehicle that it is for."
  @spec push(t(), Frame.t() | MavCodec.Tlog.Damage.t()) :: {t(), [found()]}
  def push(commands, %Frame{} = frame) do
    {commands, found} = commands |> told(Splitter.checked(frame), frame)
    {machine, _outputs} = Machine.push(commands.machine, frame)
    {%{commands | machine: machine}, found}
  end

  def push(commands, damage) do
    {machine, _outputs} = Machine.push(commands.machine, damage)
    {%{commands | machine: machine}, []}
  end

  defp told(%{machine: machine} = commands, frame, recorded) do
    row = Messages.row(frame.id)

    case kind(row, frame, machine) do
      :nothing -> {commands, []}
      :order -> first(commands, row, frame, recorded)
      reason -> {skip(commands, reason), []}
    end
  end

  defp kind(nil, frame, machine), do: if(vehicle?(machine, frame), do: :nothing, else: :unknown)

  defp kind(%{order?: order?, permission: permission, limited: limited?}, frame, machine)
       when order? or limited? or permission == :manual do
    cond do
      question?(frame) -> :nothing
      vehicle?(machine, frame) -> if(order? and other?(machine, frame), do: :vehicle, else: :nothing)
      permission == nil -> :never
      true -> :order
    end
  end

  defp kind(_row, _frame, _machine), do: :nothing

  defp question?(frame) do
    number = Command.of(frame)
    number != nil and MavCodec.Meaning.Commands.question?(number)
  end

  defp vehicle?(%{own: own, vehicles: vehicles}, frame),
    do: own != {frame.system, frame.component} and is_map_key(vehicles, frame.system)

  defp other?(%{vehicles: vehicles}, frame) do
    case Frame.target(frame) do
      {system, _component} -> system != frame.system and is_map_key(vehicles, system)
      nil -> false
    end
  end

  defp first(commands, row, frame, recorded) do
    key = :erlang.phash2(recorded.bytes, 0x100000000)

    case commands.sent do
      %{^key => at} when abs(frame.at - at) < @copy_us ->
        {skip(commands, :copy), []}

      sent ->
        sent = if map_size(sent) < @max_sent, do: sent, else: %{}
        read(%{commands | sent: Map.put(sent, key, frame.at)}, row, frame)
    end
  end

  defp read(commands, row, frame) do
    with {:ok, message} <- MavCodec.decode(frame),
         [_ | _] = snapshots <- snapshots(commands.machine, Frame.target(frame)) do
      {commands, Enum.map(snapshots, &found(&1, message, row, frame, commands.machine))}
    else
      [] -> {skip(commands, :unheard), []}
      {:error, _why} -> {skip(commands, :unreadable), []}
    end
  end

  defp snapshots(machine, {system, _component}) when system != 0,
    do: machine |> Machine.snapshot(system) |> List.wrap()

  defp snapshots(machine, _all), do: machine |> Machine.snapshots() |> Enum.sort() |> Enum.map(&elem(&1, 1))

  defp found(snapshot, message, row, frame, machine) do
    %{
      at: frame.at,
      from: {frame.system, frame.component},
      own?: machine.own == {frame.system, frame.component},
      class: row.class,
      name: name(message, frame),
      message: message,
      snapshot: snapshot
    }
  end

  # What people search for: the command of a COMMAND_LONG.
  defp name(message, frame) do
    case Command.of(frame) do
      nil ->
        if is_map_key(message, :param_id),
          do: "#{All.name(frame.id)} #{message.param_id}",
          else: All.name(frame.id)

      number ->
        command(MavCodec.Meaning.Commands.get(number), number)
    end
  end

  defp command(nil, number), do: "MAV_CMD #{number}"
  defp command(%{name: name}, _number), do: name

  defp skip(commands, reason), do: %{commands | skipped: Map.update(commands.skipped, reason, 1, &(&1 + 1))}
end
