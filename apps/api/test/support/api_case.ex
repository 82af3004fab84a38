defmodule Aerie.APICase do
  @moduledoc "A gateway without links and NATS, its HTTP server on a free port, and a plain HTTP client."
  use ExUnit.CaseTemplate

  alias Aerie.Base.Secret
  alias Aerie.JsonSchemaCheck

  using do
    quote do
      import Aerie.APICase
    end
  end

  @document Path.expand("../../../../docs/openapi.json", __DIR__)
  @key "a-key-for-the-tests-0123"

  @doc "The key that `start_server(key: true)` configures."
  @spec key() :: String.t()
  def key, do: @key

  @doc "Starts a gateway's store and HTTP server; gives its name and port. `key: true`, `keys_file: PATH`, `origins: [...]`, `hosts: [...]`, `proxies: [...]`,
  `websocket: %{}`,
  `links: true`, `recorder: %{}` (keys of that section), `config: %{}` (further sections)."
  @spec start_server(keyword()) :: %{gateway: reference(), port: :inet.port_number()}
  def start_server(options \\ []) do
    gateway = make_ref()
    parts = if options[:links], do: [:router, :links], else: [:router]

    config = %{
      api: %{
        key: if(options[:key], do: Secret.new(@key)),
        keys_file: options[:keys_file],
        origins: options[:origins] || []
      },
      http: %{port: 0, hosts: options[:hosts] || [], proxies: options[:proxies] || []},
      websocket: Keyword.get(options, :websocket, %{enabled: false}),
      recorder: Keyword.get(options, :recorder, %{})
    }

    config = Map.merge(config, options[:config] || %{})
    Aerie.GatewayCase.start_gateway(config, name: gateway, with: parts)
    start_endpoint(gateway, config)
    %{gateway: gateway, port: Aerie.Api.Endpoint.port(gateway)}
  end

  @doc "Starts the HTTP server of a gateway, with some keys of the configuration; without the console unless they name it."
  @spec start_endpoint(term(), map(), keyword()) :: pid()
  def start_endpoint(gateway, config, options \\ []) do
    settings = config |> Map.put_new(:console, %{enabled: false}) |> Aerie.Api.Settings.from()

    ExUnit.Callbacks.start_supervised!(
      {Aerie.Api.Endpoint, [gateway: gateway, settings: settings] ++ options}
    )
  end

  @doc "One request; gives status, headers and the decoded body (nil when it is empty)."
  @spec request(:inet.port_number(), String.t(), String.t(), [{String.t(), String.t()}], iodata()) ::
          {100..599, map(), term()}
  def request(port, method, path, headers \\ [], body \\ "") do
    headers = [{"host", "127.0.0.1:#{port}"}, {"connection", "close"} | headers]
    length = if body == "", do: [], else: [{"content-length", "#{IO.iodata_length(body)}"}]
    headers = Enum.uniq_by(Enum.reverse(headers ++ length), &elem(&1, 0))
    lines = for {name, value} <- headers, do: [name, ": ", value, "\r\n"]

    answer = answer(port, [method, " ", path, " HTTP/1.1\r\n", lines, "\r\n", body])
    [head, body] = String.split(answer, "\r\n\r\n", parts: 2)
    ["HTTP/1.1 " <> <<status::binary-3, _reason::binary>> | lines] = String.split(head, "\r\n")
    headers = Map.new(lines, fn line -> line |> String.split(": ", parts: 2) |> List.to_tuple() end)
    body = if body != "" and method != "HEAD", do: JSON.decode!(body)
    if body != nil and status =~ ~r/^2/, do: described!(method, path, status, body)
    {String.to_integer(status), headers, body}
  end

  # What is answered is what docs/openapi.json says, whichever test asks.
  defp described!(method, path, status, body) do
    method = String.downcase(method)
    document = @document |> File.read!() |> JSON.decode!()
    [path | _query] = String.split(path, "?")

    for {template, %{^method => %{"responses" => %{^status => %{"content" => content}}}}} <- document["paths"],
        %{"application/json" => %{"schema" => schema}} <- [content],
        path =~ pattern(template),
        do: assert({method, path, JsonSchemaCheck.errors(schema, body, document)} == {method, path, []})
  end

  defp pattern(template) do
    inside = template |> String.replace("{path}", ".+") |> String.replace(~r/{[a-z]+}/, "[^/]+")
    Regex.compile!("^#{inside}$")
  end

  @doc "Sends bytes to the server and returns everything that it answers until it closes."
  @spec raw(:inet.port_number(), iodata()) :: binary()
  def raw(port, bytes) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
    _ = :gen_tcp.send(socket, bytes)
    all(socket, "")
  end

  @doc """
  The same until there is an answer. On a busy machine the server may give up a connection before the request is sent,
  which is then never read.
  """
  @spec answer(:inet.port_number(), iodata()) :: binary()
  def answer(port, bytes), do: eventually(fn -> with "" <- raw(port, bytes), do: nil end)

  defp all(socket, got) do
    case :gen_tcp.recv(socket, 0, Aerie.Patience.ms()) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> got
    end
  end

  @doc "A vehicle's snapshot in the store."
  @spec put_vehicle(term(), String.t(), pos_integer()) :: :ok
  def put_vehicle(gateway, id, system) do
    now = System.os_time(:microsecond)

    Aerie.Base.Store.put_vehicle(gateway, {"main", system}, %Aerie.Vehicle.Snapshot{
      id: id,
      key: {"main", system},
      network: "main",
      system_id: system,
      autopilot: :px4,
      vehicle_type: "copter",
      firmware: "1.15.4",
      status: :online,
      last_heard: now,
      links: ["radio"],
      groups: %{
        position: %{at: now, time_boot_ms: 5, data: %{lat: 47.1, lon: :nan, alt_msl: nil, alt_rel: 3.5}}
      }
    })
  end

  @doc "See `Aerie.Patience.eventually/1`."
  @spec eventually((-> result)) :: result when result: term()
  defdelegate eventually(fun), to: Aerie.Patience
end
