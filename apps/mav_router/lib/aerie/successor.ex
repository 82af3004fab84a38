defmodule Aerie.Successor do
  @moduledoc """
  Starts a process whose name, or the name of a process that it starts itself, may still be held by its predecessor: when a
  supervisor is killed, its children learn of it a moment later than the one who restarts it. Waits for the predecessor to
  end, and ends it when it does not. Without it such a restart fails several times in a moment, and uses up the restarts
  of everything above.
  """

  @patience_ms 1_000
  # A supervisor's start meets the names of its children one after the other.
  @most 256

  @doc "Calls `start`, again once each predecessor that is in the way has gone."
  @spec start((-> result), non_neg_integer) :: result when result: {:ok, pid} | :ignore | {:error, term}
  def start(start, most \\ @most) do
    with {:error, reason} = failed <- start.() do
      case predecessor(reason) do
        pid when is_pid(pid) and pid != self() and most > 0 ->
          await_end(pid)
          start(start, most - 1)

        _other_reason ->
          failed
      end
    end
  end

  @doc "A child's specification with a start that waits for predecessors."
  @spec child_spec(Supervisor.module_spec() | module) :: Supervisor.child_spec()
  def child_spec(child) do
    %{start: start} = spec = Supervisor.child_spec(child, [])
    %{spec | start: {__MODULE__, :start_mfa, [start]}}
  end

  @doc false
  @spec start_mfa({module, atom, [term]}) :: {:ok, pid} | :ignore | {:error, term}
  def start_mfa({module, function, arguments}), do: start(fn -> apply(module, function, arguments) end)

  defp await_end(pid) do
    monitor = Process.monitor(pid)

    receive do
      {:DOWN, ^monitor, :process, ^pid, _reason} -> :ok
    after
      @patience_ms ->
        Process.exit(pid, :kill)
        receive(do: ({:DOWN, ^monitor, :process, ^pid, _reason} -> :ok))
    end
  end

  # A supervisor says so of a child inside its own reason.
  defp predecessor({:already_started, pid}) when is_pid(pid), do: pid
  defp predecessor({:shutdown, {:failed_to_start_child, _id, reason}}), do: predecessor(reason)
  defp predecessor({:failed_to_start_child, _id, reason}), do: predecessor(reason)
  defp predecessor({{:shutdown, reason}, _child}), do: predecessor(reason)
  defp predecessor({:badmatch, {:error, reason}}), do: predecessor(reason)
  defp predecessor({reason, trace}) when is_list(trace), do: predecessor(reason)
  defp predecessor({:EXIT, reason}), do: predecessor(reason)
  defp predecessor(_other), do: nil
end
