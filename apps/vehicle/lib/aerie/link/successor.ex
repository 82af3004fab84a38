defmodule Aerie.Link.Successor do
  @moduledoc """
  Starts a process whose name may still be held by its predecessor: when a supervisor is killed, its children learn of it
  a moment later than the one who restarts it. Waits for the predecessor to end, and ends it when it does not.
  """

  @patience_ms 1_000

  @doc "Calls `start`, again once a predecessor that is in the way has gone."
  @spec start((-> {:ok, pid} | :ignore | {:error, term})) :: {:ok, pid} | :ignore | {:error, term}
  def start(start) do
    with {:error, {:already_started, pid}} <- start.() do
      monitor = Process.monitor(pid)

      receive do
        {:DOWN, ^monitor, :process, ^pid, _reason} -> :ok
      after
        @patience_ms ->
          Process.exit(pid, :kill)
          receive(do: ({:DOWN, ^monitor, :process, ^pid, _reason} -> :ok))
      end

      start.()
    end
  end
end
