defmodule Aerie.SystemCase do
  @moduledoc """
  A whole gateway for a test, started as `bin/run` starts it: embedded nats-server, HTTP, links, all on free ports, in its
  own folder and under its own name. The test's `tmp_dir` has a name that a shell would take apart.
  """

  use ExUnit.CaseTemplate

  alias Aerie.CLI.Start.Run

  using do
    quote do
      import Aerie.SystemCase
      alias Aerie.Base.Store
    end
  end

  setup {Aerie.Lane, :setup}

  setup context do
    with %{tmp_dir: folder} <- context do
      folder = Path.join(folder, "Jörg's $drones & co")
      File.mkdir_p!(folder)
      [tmp_dir: folder]
    else
      _no_folder -> :ok
    end
  end

  @doc """
  Starts a gateway. `options`: `links` (their URLs), `overrides` (configuration), `config_file`, `gateway` (its name), `without` (keys that
  the file is to say). Returns what `Aerie.CLI.Start.Run.start/2`
  does, with `link` ports by id.
  """
  def start_gateway(folder, options \\ []) do
    supervisor = ExUnit.Callbacks.start_supervised!({DynamicTop, []}, id: make_ref())
    gateway = options[:gateway] || make_ref()

    links =
      for {url, n} <- Enum.with_index(options[:links] || [], 1), do: %{"id" => "link-#{n}", "url" => url}

    policy = Map.put(own(folder)["policy"], "clients", stations(options[:stations]))
    overrides = options[:overrides] || %{}
    # A test says what it wants of the policy, and the audit log keeps its folder.
    overrides = Map.replace_lazy(overrides, "policy", &Map.merge(policy, &1))
    overrides = folder |> own() |> Map.merge(%{"links" => links, "policy" => policy}) |> Map.merge(overrides)
    overrides = Map.drop(overrides, options[:without] || [])
    plan = %{config_file: options[:config_file], overrides: overrides, sim: 0}
    {:ok, run} = Run.start(plan, gateway: gateway, supervisor: supervisor, status: false)
    eventually(fn -> match?(%{connected: true}, Aerie.Fleet.Bridge.info(gateway)) end, "NATS is connected")
    Map.put(run, :top, supervisor)
  end

  # What every gateway of a test has: its files below one folder, and no port that another one could want.
  defp own(folder) do
    dir = &%{"dir" => Path.join(folder, &1)}

    %{
      "environment" => "test",
      "mavlink" => %{"local_addr" => "off"},
      "http" => %{"port" => 0},
      "websocket" => %{"port" => 0},
      "sockets" => %{"dir" => short_dir()},
      "nats" => %{"port" => 0, "store_dir" => Path.join(folder, "nats")},
      "policy" => %{"audit" => dir.("audit")},
      "commands" => %{"ledger" => dir.("ledger"), "record_s" => 60.0},
      "recorder" => dir.("recordings"),
      "outbox" => dir.("outbox"),
      "console" => dir.("console"),
      "params" => dir.("params"),
      "shadow" => dir.("shadow"),
      "tracks" => dir.("tracks")
    }
  end

  @doc """
  Writes the configuration of a gateway that runs in an OS process of its own, and gives the file: what
  `start_gateway/2` gives one, with the keys that a test has for some sections. Only its owner may read it.
  """
  def config_file(folder, sections) do
    dirs = for name <- ~w(signing shell), into: own(folder), do: {name, %{"dir" => Path.join(folder, name)}}
    sections = sections |> Map.new() |> JSON.encode!() |> JSON.decode!()
    sections = Map.merge(dirs, sections, fn _name, own, keys -> merge(own, keys) end)
    # JSON is YAML as well.
    private_file(
      folder,
      "gateway.yaml",
      for({name, keys} <- sections, do: [name, ": ", JSON.encode!(keys), "\n"])
    )
  end

  defp merge(%{} = own, %{} = keys), do: Map.merge(own, keys, fn _key, own, keys -> merge(own, keys) end)
  defp merge(_own, keys), do: keys

  defp stations(nil), do: []
  defp stations(permissions), do: [%{"role" => "operator", "permissions" => permissions}]

  @doc "Ends the gateway of `start_gateway/2` in order; it does not come back."
  def stop_gateway(%{top: top, gateway: gateway}),
    do: :ok = Supervisor.terminate_child(top, {:gateway, gateway})

  @doc """
  Options of a simulated vehicle that flies five times as fast as a real one. It stays armed on the ground: its own ten seconds
  until it disarms are two of ours, too few on a busy machine.
  """
  def fast_vehicle(firmware, params \\ %{}),
    do: [firmware: firmware, ready_s: 1.0, speed: 5.0, params: Map.merge(stays_armed(firmware), params)]

  defp stays_armed(:ardupilot), do: %{"DISARM_DELAY" => 0}
  defp stays_armed(:px4), do: %{"COM_DISARM_PRFLT" => 0}

  @doc "What the store has of a group of a vehicle's state; an empty map before it was heard."
  def data(gateway, group, key \\ {"main", 1}) do
    case Aerie.Base.Store.vehicle(gateway, key) do
      %{groups: %{^group => %{data: data}}} -> data
      _unheard -> %{}
    end
  end

  @doc "Waits until a vehicle is known to stand on the ground, with its home."
  def await_standing(gateway, key \\ {"main", 1}) do
    known = fn -> data(gateway, :home, key)[:alt_msl] && data(gateway, :mode, key)[:in_air] == false end
    eventually(known, "vehicle, home and landed state are known")
  end

  defdelegate short_dir, to: Aerie.ShortDir, as: :new

  @doc "The port of a link, once it is open."
  def link_port(gateway, id) do
    eventually(
      fn ->
        case Aerie.Base.Store.link(gateway, id) do
          %{port: port, status: status} when is_integer(port) and status in [:up, :idle] -> port
          _not_yet -> nil
        end
      end,
      "link #{id} is open"
    )
  end

  @doc "A UDP port that is free at the moment, for a link that needs the same port after a restart."
  def free_udp_port, do: free_port(:gen_udp, :open)

  @doc "A TCP port that is free at the moment, chosen likewise."
  @spec free_tcp_port() :: :inet.port_number()
  def free_tcp_port, do: free_port(:gen_tcp, :listen)

  defp free_port(module, open) do
    port = Enum.random(20_000..29_999)

    case apply(module, open, [port, [ip: {127, 0, 0, 1}]]) do
      {:ok, socket} ->
        module.close(socket)
        port

      {:error, :eaddrinuse} ->
        free_port(module, open)
    end
  end

  @doc "A plain NATS client of the gateway's server."
  def nats_client(gateway) do
    %URI{host: host, port: port, userinfo: token} = URI.parse(Aerie.Fleet.Bridge.login_url(gateway))

    {:ok, conn} =
      Gnat.start_link(%{host: host, port: port, token: token, connection_timeout: Aerie.Patience.ms()})

    conn
  end

  @doc "All events of the stream, in order, decoded."
  def stream_events(conn) do
    %{state: %{first_seq: first, last_seq: last}} =
      jetstream(fn -> Gnat.Jetstream.API.Stream.info(conn, "FLEET_EVENTS") end)

    # An empty stream has first 0 or 1 and last 0.
    for seq <- max(first, 1)..last//1 do
      message = jetstream(fn -> Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_EVENTS", %{seq: seq}) end)
      JSON.decode!(message.data)
    end
  end

  @doc "The answer of JetStream. A nats-server that stands still for longer than a request waits answers the next time."
  @spec jetstream((-> {:ok, answer} | {:error, term()})) :: answer when answer: term()
  def jetstream(request) do
    eventually(
      fn ->
        case request.() do
          {:ok, answer} -> answer
          {:error, :timeout} -> nil
          # Its leaders are elected again.
          {:error, %{"code" => 503}} -> nil
          {:error, reason} -> ExUnit.Assertions.flunk("JetStream: #{inspect(reason)}")
        end
      end,
      "JetStream answers"
    )
  end

  @doc """
  As `:httpc.request/4`. A request that was not read in time, because one of the two stood still, is repeated: the server closes
  its connection unread after five seconds.
  """
  def http(method, request, options \\ []) do
    case :httpc.request(method, request, options, body_format: :binary) do
      {:error, :socket_closed_remotely} -> http(method, request, options)
      answer -> answer
    end
  end

  @doc """
  A request to the REST interface of a gateway, or at a port, with a `:key` if there is one: the status, and the body,
  decoded if it is JSON. `path` begins with a slash, or below `/api/`. A body that is not text is sent as JSON.
  """
  def rest(gateway, method, path, body \\ nil, options \\ []) do
    port = if is_integer(gateway), do: gateway, else: Aerie.Api.Endpoint.port(gateway)
    path = if String.starts_with?(path, "/"), do: path, else: "/api/" <> path
    url = ~c"http://127.0.0.1:#{port}#{path}"
    headers = [{"connection", "close"} | for(key <- List.wrap(options[:key]), do: {"x-aerie-key", key})]
    headers = for {name, value} <- headers, do: {to_charlist(name), to_charlist(value)}

    {:ok, {{_version, status, _reason}, headers, reply}} =
      http(method, asked(method, url, headers, body, options))

    json? = Enum.any?(headers, &match?({~c"content-type", ~c"application/json" ++ _}, &1))
    {status, if(json? and reply != "", do: JSON.decode!(reply), else: reply)}
  end

  defp asked(method, url, headers, nil, _options) when method in [:get, :delete], do: {url, headers}
  defp asked(_method, url, headers, nil, _options), do: {url, headers, ~c"", ""}

  defp asked(_method, url, headers, body, options) do
    type = to_charlist(options[:type] || "application/json")
    {url, headers, type, if(is_binary(body), do: body, else: JSON.encode!(body))}
  end

  @doc "A request over NATS, signed if there is a key: the answer, decoded."
  def nats_request(conn, subject, body, nkey \\ nil) do
    body = if is_binary(body), do: body, else: JSON.encode!(body)
    sign = &Aerie.Control.Policy.Roles.Signature.sign(&1, subject, body, DateTime.utc_now())
    headers = for key <- List.wrap(nkey), do: {"Aerie-Signature", sign.(key)}
    options = [headers: headers, receive_timeout: Aerie.Patience.ms()]
    {:ok, %{body: reply}} = Gnat.request(conn, subject, body, options)
    JSON.decode!(reply)
  end

  @doc "Writes a file that only its owner may read, as those of keys must be; gives its path."
  def private_file(folder, name, text) do
    path = Path.join(folder, name)
    File.write!(path, text)
    File.chmod!(path, 0o600)
    path
  end

  @doc "The section `timeouts` of a gateway whose vehicles nobody is to lose: a busy machine may be silent for five seconds."
  def patient, do: %{"vehicle_stale_s" => 60.0, "vehicle_lost_s" => 120.0}

  @doc "See `Aerie.Patience.eventually/3`."
  @spec eventually((-> result), String.t() | (-> String.t()), integer()) :: result when result: term()
  def eventually(fun, what, deadline \\ Aerie.Patience.deadline()),
    do: Aerie.Patience.eventually(fun, what, deadline)
end

defmodule DynamicTop do
  @moduledoc false
  use Supervisor

  def start_link(_options), do: Supervisor.start_link(__MODULE__, [])

  @impl Supervisor
  def init(_options), do: Supervisor.init([], strategy: :one_for_one)
end
