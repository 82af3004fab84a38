defmodule Aerie.Base.Names.Successor do
  @patience_ms 1_000

  @moduledoc """
  Child specifications whose start waits until a predecessor has ended. When a supervisor is killed, its children learn of it a moment
  after the supervisor above has restarted it, and may still hold their names. Without this the restart fails several times in
  a moment and uses up the restarts of everything above.

  Two supervisors need it: that of a gateway's parts, each of which is a supervisor with named children, and that of the
  links' trees, because recordings and sockets are closed in order before a link's name is free.

  A predecessor is a process with a supervisor above it that is dead; if it is still there after #{@patience_ms} ms, it is killed. Any
  other process keeps its name, and the start fails with `{:already_started, pid}`.
  """

  # A supervisor's start meets the names of its children one after the other.
  @most 256

  @doc "The specification of a child whose start waits for predecessors."
  @spec child_spec(Supervisor.module_spec() | module | Supervisor.child_spec()) :: Supervisor.child_spec()
  def child_spec(child) do
    %{start: start} = spec = Supervisor.child_spec(child, [])
    %{spec | start: {__MODULE__, :start, [start]}}
  end

  @doc false
  @spec start({module, atom, [term]}, non_neg_integer) :: {:ok, pid} | :ignore | {:error, term}
  def start({module, function, arguments} = mfa, most \\ @most) do
    with {:error, reason} = failed <- apply(module, function, arguments) do
      pid = holder(reason)

      if pid != nil and most > 0 and orphan?(pid) do
        await_end(pid)
        start(mfa, most - 1)
      else
        failed
      end
    end
  end

  @doc """
  Waits until all processes below a supervisor that has died have ended, for the start of the next one of its name.
  """
  @spec await_end_below(atom) :: :ok
  def await_end_below(supervisor) do
    for pid <- Process.list(),
        {_key, [_ | _] = ancestors} <- [:erlang.process_info(pid, {:dictionary, :"$ancestors"})],
        supervisor in ancestors,
        do: await_end(pid)

    :ok
  end

  defp orphan?(pid) do
    case :erlang.process_info(pid, {:dictionary, :"$ancestors"}) do
      {_key, ancestors} when is_list(ancestors) ->
        Enum.any?(ancestors, &(is_pid(&1) and not Process.alive?(&1)))

      # It has ended in the meantime.
      _no_ancestors ->
        not Process.alive?(pid)
    end
  end

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

  # The holder of the name: of the process itself, or of a child that its supervisor could not start.
  defp holder({:already_started, pid}), do: pid
  defp holder({:shutdown, {:failed_to_start_child, _id, reason}}), do: holder(reason)
  defp holder(_other), do: nil
end
