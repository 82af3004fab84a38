defmodule Aerie.Processes.Busiest do
  @moduledoc "The processes of the virtual machine that do the most work (reductions)."

  @shown 20

  @typedoc "`reductions` per second; `memory` in bytes, `queue` in messages."
  @type row :: %{
          pid: pid(),
          name: String.t(),
          memory: non_neg_integer(),
          reductions: number(),
          queue: non_neg_integer()
        }

  @doc "Looks twice, so many milliseconds apart."
  @spec of(pos_integer()) :: [row()]
  def of(ms) do
    before = Map.new(reductions())
    Process.sleep(ms)

    busiest =
      for({pid, total} <- reductions(), do: {max(total - Map.get(before, pid, 0), 0), pid})
      |> Enum.sort(:desc)
      |> Enum.take(@shown)

    for {work, pid} <- busiest,
        [memory: memory, message_queue_len: queue] <- [Process.info(pid, [:memory, :message_queue_len])],
        do: %{pid: pid, name: name(pid), memory: memory, reductions: work * 1000 / ms, queue: queue}
  end

  defp reductions do
    for pid <- Process.list(), {:reductions, total} <- [Process.info(pid, :reductions)], do: {pid, total}
  end

  defp name(pid) do
    case {Process.info(pid, :registered_name), :proc_lib.get_label(pid)} do
      {_info, label} when label != :undefined -> inspect(label, limit: 6, printable_limit: 80)
      {{:registered_name, []}, _none} -> initial(pid)
      {{:registered_name, name}, _none} -> inspect(name)
      {nil, _gone} -> "ended"
    end
  end

  defp initial(pid) do
    {module, function, arity} = :proc_lib.translate_initial_call(pid)
    Exception.format_mfa(module, function, arity)
  end
end
