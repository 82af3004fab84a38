defmodule MavRouter.Link do
  @moduledoc """
  The links of a gateway: its physical connections to vehicles. Each is a supervised tree of its own that connects,
  reconnects with a back-off, reads, checks and counts. It keeps its identity and its counters whatever happens to it.

      {:ok, "tcp:127.0.0.1:5760"} = MavRouter.Link.start(:default, "tcp:127.0.0.1:5760")
      MavRouter.Link.list(:default)
      MavRouter.Link.stop(:default, "tcp:127.0.0.1:5760")

  `MavRouter.Link.Spec` documents connection strings, `MavRouter.Link.Core.Snapshot` what is known about a link, the README in the
  folder `link` how it works.

  ## Telemetry

  All have `gateway`, `link` and `network` in their metadata.

  | event | measurements | further metadata |
  |---|---|---|
  | `[:aerie, :link, :up]` | `reconnects` | `local` |
  | `[:aerie, :link, :down]` | `retry_ms`, `attempt` | `reason` (words) |
  | `[:aerie, :link, :ended]` | | `reason` (words): a recording is over |
  | `[:aerie, :link, :peer_up]` | | `peer` (words) |
  | `[:aerie, :link, :overload]` | `datagrams` | datagrams come faster than they are read; so many were dropped |
  | `[:aerie, :link, :relieved]` | `datagrams` | none was dropped for 10 s; so many were dropped before |
  | `[:aerie, :link, :peer_down]` | | `peer`, `reason` (words) |
  | `[:aerie, :link, :garbled]` | | `finding`: what a serial port receives instead of MAVLink (`MavRouter.Link.Serial.Finding`) |
  | `[:aerie, :link, :added]`, `[:aerie, :link, :removed]` | | |

  Bytes, frames and drops are not events: they are in the counters of the snapshot, which is published four times a second.
  """

  alias Aerie.Base.Error
  alias Aerie.Base.Store
  alias MavRouter.Link.FirstAttempt
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Supervisor, as: Links
  alias MavRouter.LinkProcess
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Tables

  @snapshot_ms 1_000

  @typedoc "The peer from which a system of the link's network was heard, one peer, or every peer."
  @type to :: {:system, non_neg_integer} | {:peer, term} | :all

  @doc """
  Adds a link and starts it; returns its id.

  A server or a recording that cannot be opened is not added: the error says why (`0.0.0.0:14550 is in use by
  mavproxy.py (process 812)`). Every other link is added whether or not it can connect now; it goes on trying.
  The options for a string are those of `MavRouter.Link.Spec.parse/2` (`:id`, `:network`, `:options`). A map is a link as the
  configuration has it, with `:url`, and `:id`, `:network`, `:label` and so on if need be.
  """
  @spec start(Names.gateway(), Spec.t() | String.t() | map, keyword) ::
          {:ok, String.t()} | {:error, Error.t()}
  def start(gateway, spec, options \\ [])

  def start(gateway, text, options) when is_binary(text) do
    case Spec.parse(text, options) do
      {:ok, spec} -> start(gateway, spec, [])
      {:error, error} -> Error.new({:invalid, Exception.message(error)})
    end
  end

  def start(gateway, link, _options) when is_map(link) and not is_struct(link) do
    case Spec.configured(link) do
      {:ok, spec} -> start(gateway, spec, [])
      {:error, words} -> Error.new({:invalid, words})
    end
  end

  def start(gateway, %Spec{} = spec, _options) do
    start = fn notify ->
      with {:ok, _tree} <- Links.start_tree(gateway, spec: spec, notify: notify), do: :ok
    end

    case FirstAttempt.start(spec, start) do
      :ok ->
        metadata = %{gateway: gateway, link: spec.id, network: spec.network}
        :telemetry.execute([:aerie, :link, :added], %{}, metadata)
        {:ok, spec.id}

      {:failed, id, text} ->
        stop(gateway, id)
        Error.new({:invalid, text})

      {:error, reason} ->
        Error.new(refusal(spec, reason))
    end
  end

  defp refusal(spec, {:already_started, _tree}), do: {:exists, :link, spec.id}
  defp refusal(_spec, :max_children), do: {:limit, "there are as many links as limits.max_links allows"}
  defp refusal(_spec, :not_running), do: {:unavailable, "the gateway is not running"}
  defp refusal(spec, reason), do: {:unavailable, "link #{spec.id} does not start: #{inspect(reason)}"}

  @doc "Ends a link and forgets it with its counters. An unknown id is fine."
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
    :ok = MavRouter.Signing.forget(gateway, id)
    :telemetry.execute([:aerie, :link, :removed], %{}, %{gateway: gateway, link: id, network: network})
  end

  @doc """
  Ends a link's process in order and starts it again: it closes its connection and connects again. Counters, routes and rules stay.
  """
  @spec restart(Names.gateway(), String.t()) :: :ok | {:error, Error.t()}
  def restart(gateway, id) do
    case Links.restart(gateway, id) do
      :ok -> :ok
      {:error, :unknown} -> Error.new({:unknown, :link, id})
      {:error, reason} -> Error.new({:unavailable, "link #{id} does not start: #{inspect(reason)}"})
    end
  end

  @doc "What people are shown of a snapshot (`Aerie.Base.Json.Object`)."
  @spec fields :: [Aerie.Base.Json.Object.t()]
  defdelegate fields, to: MavRouter.Link.Core.Snapshot

  @doc "The name of a message that links count by its id: `global_position_int`, or `unknown`."
  @spec message_name(non_neg_integer | :other) :: String.t()
  def message_name(id) do
    name = if is_integer(id), do: MavCodec.Dialects.All.name(id)
    String.downcase(name || "unknown")
  end

  @doc "The snapshots of all links (`MavRouter.Link.Core.Snapshot`), at most a quarter of a second old."
  @spec list(Names.gateway()) :: [map]
  def list(gateway), do: Store.Links.all(gateway)

  @doc "The snapshot of one link, nil for an unknown id."
  @spec get(Names.gateway(), String.t()) :: map | nil
  def get(gateway, id), do: Store.Links.whole(gateway, id)

  @doc """
  The snapshot of this moment, from the link's process; nil if it does not run. If it is too busy to answer within `wait_ms`, a
  second, the one that it published last. Clients have one as well.
  """
  @spec snapshot(Names.gateway(), String.t(), pos_integer) :: map | nil
  def snapshot(gateway, id, wait_ms \\ @snapshot_ms) do
    with pid when is_pid(pid) <- Names.whereis(gateway, :link, id),
         do: GenServer.call(pid, :snapshot, wait_ms)
  catch
    :exit, {:timeout, _call} -> get(gateway, id) || Tables.client(gateway, id)
    :exit, _ended -> nil
  end

  @doc """
  Writes whole frames without waiting: `:ok` means that the link's process gets them. What cannot be written (link down,
  peer gone, buffer full) is counted as `dropped_out`. Bytes marked by `MavRouter.Signing.mark/3` are signed when they are
  written.
  """
  @spec send_bytes(Names.gateway(), String.t(), iodata | MavRouter.Signing.marked(), to) ::
          :ok | {:error, :no_link | :no_route}
  def send_bytes(gateway, id, bytes, to \\ :all)

  def send_bytes(gateway, id, bytes, {:system, system}) do
    with %{network: network} <- get(gateway, id),
         {^id, peer} <- Router.route(gateway, {network, system}, link: id) do
      send_bytes(gateway, id, MavRouter.Signing.mark(gateway, {network, system}, bytes), {:peer, peer})
    else
      _none -> {:error, :no_route}
    end
  end

  def send_bytes(gateway, id, bytes, to), do: LinkProcess.write(gateway, id, bytes, to)
end
