defmodule Aerie.Processes.Restarts do
  @moduledoc """
  Which processes of the supervision tree died and were started again. A value, except for the monitors of the known
  processes.

  If a process died and another one has its place in the tree, it was restarted; if the place is empty, it was ended.
  """

  # A gateway with 200 vehicles has about 1,500.
  @max 4_096
  @max_counts 1_024

  defstruct known: %{}, refs: %{}, dead: %{}, counts: %{}

  @typedoc "A place in the tree: the ids from the root."
  @type path :: [term()]
  @typedoc "`at` in unix microseconds; `reason` in words."
  @type count :: %{count: pos_integer(), at: integer(), reason: String.t()}
  @type t :: %__MODULE__{}

  @doc "The state before any process is known."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Records that a monitored process ended."
  @spec down(t(), reference(), term(), integer()) :: t()
  def down(restarts, ref, reason, at) do
    case Map.pop(restarts.refs, ref) do
      {nil, _refs} ->
        restarts

      {path, refs} ->
        dead = Map.put(restarts.dead, path, %{at: at, reason: reason_text(reason)})
        %{restarts | refs: refs, known: Map.delete(restarts.known, path), dead: dead}
    end
  end

  defp reason_text(reason),
    do: reason |> Exception.format_exit() |> String.split("\n") |> hd() |> String.slice(0, 200)

  @doc "Sets the present processes by their places."
  @spec seen(t(), [{path(), pid()}], integer()) :: t()
  def seen(restarts, processes, at) do
    processes = Enum.take(processes, @max)
    restarts = Enum.reduce(processes, restarts, &process(&1, &2, at))
    # A place that has disappeared was ended.
    %{restarts | dead: %{}} |> forget(MapSet.new(processes, &elem(&1, 0)))
  end

  defp process({path, pid}, restarts, at) do
    case restarts.known do
      %{^path => {^pid, _ref}} ->
        restarts

      known ->
        # The message about its end may not have arrived yet.
        {died, known} = Map.pop(known, path)
        ref = Process.monitor(pid)
        dead = restarts.dead[path] || (died && %{at: at, reason: "not known yet"})

        restarts = %{
          restarts
          | known: Map.put(known, path, {pid, ref}),
            refs: Map.put(restarts.refs, ref, path)
        }

        restarts = if died, do: drop(restarts, elem(died, 1)), else: restarts
        if dead, do: count(restarts, path, dead), else: restarts
    end
  end

  defp drop(restarts, ref) do
    Process.demonitor(ref, [:flush])
    %{restarts | refs: Map.delete(restarts.refs, ref)}
  end

  defp count(%{counts: counts} = restarts, path, %{at: at, reason: reason})
       when is_map_key(counts, path) or map_size(counts) < @max_counts do
    n = get_in(counts, [path, :count]) || 0
    %{restarts | counts: Map.put(counts, path, %{count: n + 1, at: at, reason: reason})}
  end

  defp count(restarts, _path, _dead), do: restarts

  defp forget(restarts, there) do
    {gone, known} = Enum.split_with(restarts.known, fn {path, _process} -> path not in there end)
    restarts = Enum.reduce(gone, restarts, fn {_path, {_pid, ref}}, restarts -> drop(restarts, ref) end)

    %{
      restarts
      | known: Map.new(known),
        counts: Map.filter(restarts.counts, fn {path, _count} -> path in there end)
    }
  end

  @doc "The restarts at a place, or nil."
  @spec of(t(), path()) :: count() | nil
  def of(restarts, path), do: restarts.counts[path]
end
