defmodule FleetWeb.Console.System.BusiestProcesses do
  @moduledoc "The busiest processes of the virtual machine: by memory, reductions (work) since the last sample, and waiting messages."

  @shown 20
  # With more processes than this the lists are left out.
  @max 50_000

  @typedoc "`reductions` per second since the last sample, nil in the first one."
  @type row :: %{
          pid: pid(),
          name: String.t(),
          memory: non_neg_integer(),
          reductions: float() | nil,
          queue: non_neg_integer()
        }
  @type t :: %{memory: [row()], reductions: [row()], queue: [row()], looked_at: non_neg_integer()}

  @doc "The lists, and the reductions for the next comparison. `elapsed_ms`: time since the last sample, nil if there is none."
  @spec of(%{pid() => non_neg_integer()}, pos_integer() | nil) :: {t(), %{pid() => non_neg_integer()}}
  def of(before, elapsed_ms) do
    rows = if :erlang.system_info(:process_count) <= @max, do: rows(before, elapsed_ms), else: []

    {%{
       memory: top(rows, & &1.memory),
       reductions: top(rows, &(&1.reductions || 0)),
       queue: rows |> Enum.filter(&(&1.queue > 0)) |> top(& &1.queue),
       looked_at: length(rows)
     }, Map.new(rows, &{&1.pid, &1.total})}
  end

  defp rows(before, elapsed_ms) do
    for pid <- Process.list(),
        [memory: memory, reductions: total, message_queue_len: queue] <-
          [Process.info(pid, [:memory, :reductions, :message_queue_len])] do
      work = if elapsed_ms, do: max(total - Map.get(before, pid, 0), 0) * 1000 / max(elapsed_ms, 1)
      %{pid: pid, memory: memory, reductions: work, queue: queue, total: total}
    end
  end

  # Names are looked up only for the processes that are shown.
  defp top(rows, by) do
    rows
    |> Enum.sort_by(by, :desc)
    |> Enum.take(@shown)
    |> Enum.map(&(&1 |> Map.put(:name, name(&1.pid)) |> Map.delete(:total)))
  end

  defp name(pid) do
    case {Process.info(pid, [:registered_name, :initial_call]), :proc_lib.get_label(pid)} do
      {_info, label} when label != :undefined -> inspect(label, limit: 6, printable_limit: 80)
      {[registered_name: name, initial_call: _call], _none} when is_atom(name) -> inspect(name)
      {[registered_name: _none, initial_call: _call], _no_label} -> initial(pid)
      {nil, _gone} -> "ended"
    end
  end

  defp initial(pid) do
    {module, function, arity} = :proc_lib.translate_initial_call(pid)
    Exception.format_mfa(module, function, arity)
  end
end
