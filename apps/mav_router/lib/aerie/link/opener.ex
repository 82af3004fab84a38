defmodule Aerie.Link.Opener do
  @moduledoc """
  Opens a connection in a process of its own, so that a slow name server, a host that does not answer or a device that
  hangs never stops the link's process from answering, and so that it can be given up at any time.

  Linked to the link's process, which traps exits: it gets `{:opener, pid, {:ok, conn} | {:error, reason}}`, or the exit
  of an opener that crashed.
  """

  alias Aerie.Link.PortOwner
  alias Aerie.Link.Spec
  alias Aerie.Link.Transport

  @doc "Starts opening; the calling process is the link."
  @spec start(Spec.t()) :: pid
  def start(%Spec{} = spec) do
    link = self()
    transport = Transport.module(spec.kind)

    spawn_link(fn ->
      Process.set_label({:opener, spec.id})

      result =
        with {:ok, conn} <- transport.open(spec),
             :ok <- transport.give(conn, link),
             do: {:ok, conn}

      send(link, {:opener, self(), explain(result, spec)})
    end)
  end

  # Looking for the owner reads half of /proc: not the link's process' work.
  defp explain({:error, :eaddrinuse}, spec) do
    protocol = if spec.kind in [:udp_server, :udp_client], do: :udp, else: :tcp

    own = String.to_integer(System.pid())

    case PortOwner.find(protocol, spec.port) do
      {:ok, _program, ^own} -> {:error, {:in_use, "this gateway (process #{own})"}}
      {:ok, program, pid} -> {:error, {:in_use, "#{program} (process #{pid})"}}
      :unknown -> {:error, {:in_use, "another program"}}
    end
  end

  defp explain(result, _spec), do: result
end
