defmodule Aerie.Vehicle.State.Groups do
  @moduledoc """
  The groups of a vehicle's state, in the order of the documentation, and the modules that read messages. A new group is a module
  (`Aerie.Vehicle.State.Group`) and its name in this list: fields, units, rounding, sampling, NATS, REST, the console's charts and
  `docs/telemetry.md` follow from it.
  """

  alias Aerie.Vehicle.State
  alias MavCodec.Messages, as: M

  @groups [
    State.Groups.Position,
    State.Groups.Attitude,
    State.Groups.Velocity,
    State.Groups.Battery,
    State.Groups.Gps,
    State.Groups.Mode,
    State.Groups.Health,
    State.Groups.Home,
    State.Groups.Mission,
    State.Groups.Rc,
    State.Groups.Operator,
    State.Groups.Link
  ]

  @all Enum.map(@groups, & &1.group())
  @keys for %{name: name, fields: fields} <- @all,
            do: {name, for(%{path: [key]} <- fields, do: key)}

  messages =
    for module <- @groups, message <- module.group().messages do
      case message do
        {second, first} -> {second.id(), module, first.id()}
        message -> {message.id(), module, nil}
      end
    end

  # HIGH_LATENCY2 has values of several groups.
  @readers Map.new([{M.HighLatency2.id(), State.HighLatency, nil} | messages], fn {id, module, _first} ->
             {id, module}
           end)
  @first_choice for {id, _module, first} when first != nil <- messages, into: %{}, do: {id, first}

  @doc "All groups."
  @spec all() :: [State.Group.t(), ...]
  def all, do: @all

  @doc "The groups and the keys of their data."
  @spec keys() :: [{State.group(), [atom()]}]
  def keys, do: @keys

  @doc "Whether a message is read at all."
  @spec reads?(non_neg_integer()) :: boolean()
  def reads?(id), do: is_map_key(@readers, id)

  @doc "The module that reads a message."
  @spec reader(non_neg_integer()) :: module()
  def reader(id), do: Map.fetch!(@readers, id)

  @doc "The message that is read in place of this one while it comes, or nil."
  @spec first_choice(non_neg_integer()) :: non_neg_integer() | nil
  def first_choice(id), do: Map.get(@first_choice, id)
end
