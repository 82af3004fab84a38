defmodule Aerie.Shell.Text do
  @moduledoc "What `Aerie.Shell` prints, as text. Pure: from snapshots, rows and samples."

  alias Aerie.CLI.Status.Format
  alias Aerie.Fleet.Inspector
  alias Aerie.CLI.Output.Columns
  alias Aerie.Processes.{Busiest, Restarts, Tree}
  alias MavCodec.Frame

  @doc "One vehicle: a line for each value that is known, with the age of its group."
  @spec vehicle(map(), integer()) :: iodata()
  def vehicle(vehicle, now) do
    via = if vehicle.via, do: ", heard by the gateway #{vehicle.via}", else: ""

    head =
      "#{vehicle.id}: #{vehicle.autopilot} #{vehicle.vehicle_type}, system #{vehicle.system_id} of #{vehicle.network}, #{vehicle.status}#{via}\n"

    rows =
      for {name, group} <- Enum.sort(vehicle.groups), {key, value} <- Enum.sort(group.data), value != nil do
        ["#{name}.#{key}", value(value), Format.age(max(now - group.at, 0))]
      end

    [head, Columns.render(~w(FIELD VALUE AGE), rows)]
  end

  @doc "The last message of a row as one line."
  @spec message(Inspector.key(), Frame.t()) :: String.t()
  def message({_link, _way, system, component, _id}, frame) do
    shown = Inspector.show(frame)
    fields = for field <- shown.fields || [], do: "#{field.name}=#{value(field.value)}"
    Enum.join(["#{system}/#{component}", shown.name | fields], " ")
  end

  @doc "Rows of `Aerie.Fleet.Inspector.rows/2`."
  @spec trace([Inspector.row()]) :: iodata()
  def trace([]), do: "nothing went over it\n"

  def trace(rows) do
    lines =
      for %{key: {_link, way, system, component, _id}, name: name, hz: hz, count: count} <- rows,
          do: [way, "#{system}/#{component}", name, Float.round(hz * 1.0, 1), count]

    Columns.render(~w(WAY FROM MESSAGE PER-SECOND COUNT), lines)
  end

  @doc "The busiest processes."
  @spec top([Busiest.row()]) :: iodata()
  def top(rows) do
    rows = for row <- rows, do: [row.name, inspect(row.pid), round(row.reductions), row.memory, row.queue]
    Columns.render(~w(PROCESS PID REDUCTIONS/s MEMORY QUEUE), rows)
  end

  @doc "A supervision tree with its restarts."
  @spec tree([{Tree.tree_node(), Restarts.count() | nil}]) :: iodata()
  def tree([]), do: "no tree: the gateway is starting\n"

  def tree(nodes) do
    rows =
      for {node, restarts} <- nodes do
        name = String.duplicate("  ", length(node.path)) <> node.name
        [name, node.pid && inspect(node.pid), node.memory, node.queue, restarts(restarts)]
      end

    Columns.render(~w(PROCESS PID MEMORY QUEUE RESTARTS), rows)
  end

  defp restarts(nil), do: nil
  defp restarts(%{count: count, reason: reason}), do: "#{count}, the last: #{reason}"

  defp value(value) when is_binary(value) or is_atom(value) or is_number(value), do: Columns.cell(value)
  defp value(value), do: value |> inspect(limit: 20, printable_limit: 200) |> Columns.cell()
end
