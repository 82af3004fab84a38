defmodule Aerie.CLI.Subcommand.Running.Tail do
  @moduledoc "`aerie tail`: a vehicle's events, and changes of its state, as they come."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Fleet.Bridge.Message
  alias Aerie.CLI.Status.Lines
  alias Aerie.Base.Store
  alias Aerie.Fleet
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.PubSub
  alias Aerie.CLI.Output.Columns

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"VEHICLE" => id}, options: options}) do
    case Fleet.vehicle(:default, id) do
      nil ->
        {:error, unknown(id)}

      %{via: via} when via != nil ->
        {:error, elsewhere(id, via)}

      vehicle ->
        PubSub.subscribe(:default, :events)
        unless options[:events], do: PubSub.subscribe(:default, {:vehicle, id})
        follow(id, options, groups(vehicle), options[:count] || :infinity)
    end
  end

  @doc "The error for an unknown vehicle, with the names of the known ones."
  @spec unknown(String.t()) :: String.t()
  def unknown(id) do
    known = for vehicle <- Fleet.vehicles(:default), do: vehicle.id

    "there is no vehicle #{id}; " <>
      if(known == [], do: "none was heard", else: "known are #{Enum.join(known, ", ")}")
  end

  @doc "The error for a vehicle that only another gateway hears: its events and messages are there."
  @spec elsewhere(String.t(), via :: String.t()) :: String.t()
  def elsewhere(id, via),
    do:
      "#{id} is heard by the gateway #{via}, and its events and messages are seen there: ask that one; aerie status shows its state here"

  defp follow(_id, _options, _seen, 0), do: {0, ""}

  defp follow(id, options, seen, left) do
    receive do
      {:fleet, :events, %{vehicle: ^id} = event} ->
        put(
          if options[:json],
            do: Message.event(event, Journal.epoch(:default)),
            else: Columns.cell(Lines.note(event))
        )

        follow(id, options, seen, less(left))

      {:fleet, {:vehicle, ^id}, _changed} ->
        now = with(%{} = vehicle <- Store.vehicle(:default, id), do: groups(vehicle)) || %{}
        changed = for {name, group} <- now, seen[name][:data] != group.data, do: {name, group}
        changed = if left == :infinity, do: changed, else: Enum.take(changed, left)
        for {name, group} <- changed, do: put(group(id, name, group, options))
        follow(id, options, now, less(left, length(changed)))

      {:fleet, _topic, _other} ->
        follow(id, options, seen, left)
    end
  end

  defp less(left, n \\ 1)
  defp less(:infinity, _n), do: :infinity
  defp less(left, n), do: max(left - n, 0)

  # The link's counters change with every frame.
  defp groups(vehicle), do: Map.delete(vehicle.groups, :link)

  # As in NATS.
  defp group(id, name, group, %{json: true}) do
    origin = %{epoch: Journal.epoch(:default), gateway: Fleet.Bridge.name(:default)}
    Message.state(id, Atom.to_string(name), group.data, group[:time_boot_ms], group.at, origin)
  end

  defp group(_id, name, group, _options) do
    words =
      for {key, value} <- Enum.sort(group.data),
          value != nil,
          not is_map(value),
          do: "#{key}=#{Columns.cell(text(value))}"

    Enum.join(["#{name}:" | words], " ")
  end

  defp text(value) when is_binary(value) or is_atom(value) or is_number(value), do: value
  defp text(value), do: inspect(value, limit: 20, width: :infinity)

  # Standard output is aerie's own; when it is closed, this process ends as well.
  defp put(line), do: line |> Aerie.Base.Printable.lines() |> IO.puts()
end
