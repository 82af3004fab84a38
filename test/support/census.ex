defmodule Aerie.Census do
  @moduledoc """
  Counts what a node holds. None of it may grow, however long a gateway runs and whatever comes and goes.
  """

  @typedoc """
  - `memory`, `ets`, `binary`: bytes after a garbage collection of all processes; `rss`: the BEAM's resident memory
  - `kinds`: number of processes by label or initial call
  - `tables`: number of rows of ETS tables by name, summed over tables with the same name
  - `files`: file descriptors of this VM; `programs`: operating system processes that it started
  """
  @type t :: %{atom() => term()}

  @doc "Counts after a garbage collection of all processes."
  @spec take() :: t()
  def take do
    Enum.each(Process.list(), &:erlang.garbage_collect/1)
    memory = Map.new(:erlang.memory())

    %{
      memory: memory.total,
      ets: memory.ets,
      binary: memory.binary,
      rss: rss(),
      processes: length(Process.list()),
      ports: length(Port.list()),
      atoms: :erlang.system_info(:atom_count),
      files: length(File.ls!("/proc/self/fd")),
      programs: length(Aerie.Programs.running()),
      tables: tables(),
      kinds: kinds(),
      waiting: waiting()
    }
  end

  @doc "The census as one readable line."
  @spec format(t()) :: String.t()
  def format(census) do
    mb = fn bytes -> :erlang.float_to_binary(bytes / 1_048_576, decimals: 1) end

    "memory #{mb.(census.memory)} MB (ets #{mb.(census.ets)}, binary #{mb.(census.binary)}), rss #{mb.(census.rss)} MB, " <>
      "#{census.processes} processes, #{census.ports} ports, #{census.files} files, #{census.programs} programs, " <>
      "#{census.atoms} atoms, #{map_size(census.tables)} tables, longest mailbox #{census.waiting}"
  end

  @doc "Loads all modules of these apps, so that a module that is loaded late does not look like a leak."
  @spec load([atom()]) :: :ok
  def load(apps) do
    for app <- apps, module <- Application.spec(app, :modules) || [], do: Code.ensure_loaded(module)
    :ok
  end

  @doc "Which kinds of processes a later census has more of, or fewer: `{kind, before, after}`."
  @spec changed(t(), t()) :: [{term(), non_neg_integer(), non_neg_integer()}]
  def changed(first, last) do
    for kind <- Map.keys(Map.merge(first.kinds, last.kinds)),
        {before, now} = {Map.get(first.kinds, kind, 0), Map.get(last.kinds, kind, 0)},
        before != now,
        do: {kind, before, now}
  end

  defp kinds do
    Enum.frequencies_by(Process.list(), fn pid ->
      case Process.info(pid, [:label, :dictionary, :initial_call]) do
        [label: {kind, _id}, dictionary: _, initial_call: _] -> kind
        [label: :undefined, dictionary: words, initial_call: call] -> words[:"$initial_call"] || call
        [label: label, dictionary: _, initial_call: _] -> label
        nil -> :gone
      end
    end)
  end

  defp tables do
    for table <- :ets.all(), name = :ets.info(table, :name), name != :undefined, reduce: %{} do
      tables -> Map.update(tables, name, rows(table), &(&1 + rows(table)))
    end
  end

  defp rows(table) do
    case :ets.info(table, :size) do
      :undefined -> 0
      rows -> rows
    end
  end

  defp waiting do
    lengths =
      for pid <- Process.list(), {:message_queue_len, n} <- [Process.info(pid, :message_queue_len)], do: n

    Enum.max(lengths)
  end

  defp rss do
    [pages | _] = "/proc/self/statm" |> File.read!() |> String.split() |> tl()
    String.to_integer(pages) * 4_096
  end
end
