defmodule Aerie.Census do
  @moduledoc """
  What a node holds: what must not grow however long a gateway runs and whatever comes and goes meanwhile.
  """

  @typedoc """
  - `memory`, `ets`, `binary`: bytes, after all processes were swept; `rss`: what the operating system sees of the BEAM
  - `tables`: ETS tables with the number of their rows, the same for those of one name
  - `files`: descriptors of this process, `programs` the processes of the operating system that it started
  """
  @type t :: %{atom() => term()}

  @doc "Counts, after a sweep of all heaps."
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
      programs: length(programs()),
      tables: tables(),
      waiting: waiting()
    }
  end

  @doc "One line for people."
  @spec format(t()) :: String.t()
  def format(census) do
    mb = fn bytes -> :erlang.float_to_binary(bytes / 1_048_576, decimals: 1) end

    "memory #{mb.(census.memory)} MB (ets #{mb.(census.ets)}, binary #{mb.(census.binary)}), rss #{mb.(census.rss)} MB, " <>
      "#{census.processes} processes, #{census.ports} ports, #{census.files} files, #{census.programs} programs, " <>
      "#{census.atoms} atoms, #{map_size(census.tables)} tables, longest mailbox #{census.waiting}"
  end

  @doc "Loads all modules of these apps, so that what is loaded when it is first needed does not look like a leak."
  @spec load([atom()]) :: :ok
  def load(apps) do
    for app <- apps, module <- Application.spec(app, :modules) || [], do: Code.ensure_loaded(module)
    :ok
  end

  @doc "How many processes there are of each label or initial call: what to look at when there are too many."
  @spec who() :: %{term() => pos_integer()}
  def who do
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

  # The BEAM starts programs by a child of its own, whose children they are.
  defp programs, do: descendants(System.pid())

  defp descendants(pid) do
    with {:ok, tasks} <- File.ls("/proc/#{pid}/task") do
      for task <- tasks,
          {:ok, children} <- [File.read("/proc/#{pid}/task/#{task}/children")],
          child <- String.split(children),
          program <- [child | descendants(child)],
          do: program
    else
      _ended_meanwhile -> []
    end
  end
end
