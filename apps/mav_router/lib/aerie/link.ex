defmodule Aerie.Link do
  @moduledoc """
  The links of a gateway: the physical ways to vehicles. Each is a supervised tree of its own, which connects, reconnects
  with a back-off, reads, checks and counts, and which keeps its identity and its counters whatever happens to it.

      {:ok, "tcp:127.0.0.1:5760"} = Aerie.Link.start(:default, "tcp:127.0.0.1:5760")
      Aerie.Link.list(:default)
      Aerie.Link.stop(:default, "tcp:127.0.0.1:5760")

  What a connection string says is in `Aerie.Link.Spec`, what is known of a link in `Aerie.Link.Snapshot`, how it works
  in the README beside this module's folder.

  ## Telemetry

  All have `gateway`, `link` and `network` in their metadata.

  | event | measurements | further metadata |
  |---|---|---|
  | `[:aerie, :link, :up]` | `reconnects` | `local` |
  | `[:aerie, :link, :down]` | `retry_ms`, `attempt` | `reason` (words) |
  | `[:aerie, :link, :ended]` | | `reason` (words): a recording is over |
  | `[:aerie, :link, :peer_up]` | | `peer` (words) |
  | `[:aerie, :link, :overload]` | `datagrams` | datagrams come faster than they are read; those were dropped |
  | `[:aerie, :link, :relieved]` | `datagrams` | none was dropped for 10 s; so many were |
  | `[:aerie, :link, :peer_down]` | | `peer`, `reason` (words) |
  | `[:aerie, :link, :garbled]` | | `finding`: what a serial port says in the place of MAVLink (`Aerie.Link.Serial.Finding`) |
  | `[:aerie, :link, :added]`, `[:aerie, :link, :removed]` | | |

  Bytes, frames and drops are not events: they are in the snapshot's counters, written four times a second.
  """

  alias Aerie.Store
  alias Aerie.Link.Spec
  alias Aerie.Link.Supervisor, as: Links
  alias Aerie.LinkProcess
  alias Aerie.Names
  alias Aerie.Router

  # What can be in the way of these is there from the start: a taken port, a file that is not there.
  @waited_for [:udp_server, :tcp_server, :replay]
  @first_ms 5_000

  @typedoc "Where to: the peer that a system of this link's network was heard from, one peer, or every peer."
  @type to :: {:system, non_neg_integer} | {:peer, term} | :all

  @doc """
  Adds a link and starts it; gives its id.

  A server or a recording that cannot be opened now is not added: the error says why (`0.0.0.0:14550 is in use by
  mavproxy.py (process 812)`). Every other link is added whether or not it can connect now; it goes on trying.
  Options are those of `Aerie.Link.Spec.parse/2` for a string (`:id`, `:network`, `:options`).
  """
  @spec start(Names.gateway(), Spec.t() | String.t(), keyword) :: {:ok, String.t()} | {:error, String.t()}
  def start(gateway, spec, options \\ [])

  def start(gateway, text, options) when is_binary(text) do
    case Spec.parse(text, options) do
      {:ok, spec} -> start(gateway, spec, [])
      {:error, error} -> {:error, Exception.message(error)}
    end
  end

  def start(gateway, %Spec{} = spec, _options) do
    notify = :erlang.alias()

    try do
      case Links.start_tree(gateway, spec: spec, notify: notify) do
        {:ok, _tree} -> first(gateway, spec, notify)
        {:error, reason} -> {:error, refusal(spec, reason)}
      end
    after
      :erlang.unalias(notify)
    end
  end

  defp first(gateway, %{kind: kind} = spec, notify) when kind in @waited_for do
    receive do
      {^notify, :ok} ->
        added(gateway, spec)

      {^notify, {:error, text}} ->
        stop(gateway, spec.id)
        {:error, text}
    after
      # A name server that does not answer: the link goes on trying.
      @first_ms -> added(gateway, spec)
    end
  end

  defp first(gateway, spec, _notify), do: added(gateway, spec)

  defp added(gateway, spec) do
    :telemetry.execute([:aerie, :link, :added], %{}, %{gateway: gateway, link: spec.id, network: spec.network})

    {:ok, spec.id}
  end

  defp refusal(spec, {:already_started, _tree}), do: "there is a link #{spec.id} already"
  defp refusal(_spec, :max_children), do: "there are as many links as limits.max_links allows"
  defp refusal(_spec, :not_running), do: "the gateway is not running"
  defp refusal(spec, reason), do: "link #{spec.id} does not start: #{inspect(reason)}"

  @doc "Ends a link and forgets it, its counters included. An unknown link is fine."
  @spec stop(Names.gateway(), String.t()) :: :ok
  def stop(gateway, id) do
    case get(gateway, id) do
      nil -> :ok
      %{network: network} -> remove(gateway, id, network)
    end
  end

  defp remove(gateway, id, network) do
    :ok = Links.stop_tree(gateway, id)
    :ok = Store.delete_link(gateway, id)
    :ok = Router.close(gateway, id)
    :ok = Aerie.Signing.forget(gateway, id)
    :telemetry.execute([:aerie, :link, :removed], %{}, %{gateway: gateway, link: id, network: network})
  end

  @doc "The snapshots of all links (`Aerie.Link.Snapshot`), at most a quarter of a second old."
  @spec list(Names.gateway()) :: [map]
  def list(gateway), do: Store.Links.all(gateway)

  @doc "The snapshot of one link, nil for an unknown one."
  @spec get(Names.gateway(), String.t()) :: map | nil
  def get(gateway, id), do: Store.Links.whole(gateway, id)

  @doc "The snapshot of this very moment, asked of the link's process; nil when it does not run."
  @spec snapshot(Names.gateway(), String.t()) :: map | nil
  def snapshot(gateway, id) do
    with pid when is_pid(pid) <- Names.whereis(gateway, :link, id), do: GenServer.call(pid, :snapshot)
  catch
    :exit, _reason -> nil
  end

  @doc """
  Writes whole frames, without waiting: `:ok` means handed to the link's process. What cannot be written (link down,
  peer gone, buffer full) is counted as `dropped_out`. Bytes marked by `Aerie.Signing.mark/3` are signed on their way.
  """
  @spec send_bytes(Names.gateway(), String.t(), iodata | Aerie.Signing.marked(), to) ::
          :ok | {:error, :no_link | :no_route}
  def send_bytes(gateway, id, bytes, to \\ :all)

  def send_bytes(gateway, id, bytes, {:system, system}) do
    with %{network: network} <- get(gateway, id),
         {^id, peer} <- Router.way(gateway, {network, system}, link: id) do
      send_bytes(gateway, id, Aerie.Signing.mark(gateway, {network, system}, bytes), {:peer, peer})
    else
      _none -> {:error, :no_route}
    end
  end

  def send_bytes(gateway, id, bytes, to), do: LinkProcess.write(gateway, id, bytes, to)
end
