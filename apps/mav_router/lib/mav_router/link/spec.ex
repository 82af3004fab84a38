defmodule MavRouter.Link.Spec do
  @moduledoc """
  A validated connection string: what a link is to be.

  The strings are pymavlink's, so that what works with MAVProxy works here. The README of this folder lists them; each
  transport reads its own (`MavRouter.Link.Transport`).

  HOST is an IPv4 address, an IPv6 address in brackets (`[::1]`, `[fe80::1%eth0]`) or a name; it is resolved again for
  every connection attempt. For a server an empty HOST means all IPv4 addresses, and port 0 any free port.

  Every string takes these options behind a `?`:

  | option | meaning |
  |---|---|
  | `network=NAME` | the network whose system ids the link shares, default `main` |
  | `id=NAME` | the identity of the link, default the string without its options |
  | `secure=true` | only the two ends can hear or reach the link (USB, a cable of its own, loopback): a vehicle may be given its signing key there, and is believed unsigned. Refused for a broadcast, a recording, and a server on all addresses |
  | `gcs=allow`, `gcs=deny` | everybody who reaches the link may command vehicles, or nobody, not even this machine (`MavRouter.Endpoints.Access`) |
  """

  alias Aerie.Base.Net.Address
  alias MavRouter.Endpoints.Owner.RuleKeys
  alias MavRouter.Link.Spec.Error
  alias MavRouter.Link.Transport.Query
  alias MavRouter.Link.Transport

  @enforce_keys [:id, :kind, :text, :transport, :framing]
  defstruct [
    :id,
    :kind,
    :text,
    :transport,
    :framing,
    :protocol,
    :host,
    :port,
    :device,
    :file,
    :detect,
    :bauds,
    :ca,
    :inner,
    :sysid,
    :share,
    :share_origin,
    :gateway,
    :network,
    server: false,
    recorded: false,
    announced: false,
    sniffed: false,
    client: :local,
    path: "/",
    tls: false,
    ports: [],
    only: false,
    baud: 115_200,
    broadcast: false,
    speed: 1.0,
    loop: false,
    options: %{}
  ]

  @typedoc """
  - `id`: identity of the link, unique in a gateway; it outlives restarts and reconnections
  - `text`: the connection string as given, without what only a WebSocket server should see
  - `kind`, `transport` (its module), and what that says of itself: `t:MavRouter.Link.Transport.traits/0`
  - `host`, `port`: UDP, TCP and WebSocket; a host that is a string is a name still to be resolved
  - `broadcast`: whether everybody at the address hears it
  - `path` (with the query), `tls`, `ca`: WebSocket
  - `device`, `baud`: serial; `detect` is what is found by listening: nothing (nil), `:baud`, or `:port` for both
  - `bauds`, `ports`, `only`: candidates for that
  - `inner`, `sysid`, `share`: MSP: the module of the transport that it goes over, the MAVLink id of the vehicle, and the address where programs share it; `share_origin`: the page that may do so as well
  - `gateway`: whose link it is, known when it is opened
  - `file`, `speed` (factor of real time, or `:max`), `loop`: replay
  - `network`: links of one network share one space of system ids
  - `options`: tuning of the link that is not part of the string (`MavRouter.Link.Settings`)
  """
  @type t :: %__MODULE__{
          id: String.t(),
          kind: atom,
          text: String.t(),
          transport: module,
          framing: :datagram | :stream,
          protocol: :udp | :tcp | nil,
          server: boolean,
          recorded: boolean,
          announced: boolean,
          sniffed: boolean,
          client: :remote | :local | nil,
          network: String.t(),
          host: :inet.ip_address() | String.t() | nil,
          port: :inet.port_number() | nil,
          path: String.t(),
          tls: boolean,
          ca: Path.t() | nil,
          inner: module | nil,
          sysid: 1..254 | nil,
          device: String.t() | nil,
          baud: pos_integer,
          detect: nil | :baud | :port,
          bauds: [pos_integer, ...] | nil,
          ports: [String.t()],
          only: boolean,
          broadcast: boolean,
          file: Path.t() | nil,
          speed: float | :max,
          loop: boolean,
          options: map
        }

  @example "udpin:0.0.0.0:14550"
  @foreign ~w(udp:// udpin:// udpout:// tcp:// tcpin:// tcpout:// serial:// file: http:// https://)
  @max_bytes 4_096

  @doc """
  Reads a connection string. `overrides` (`:id`, `:network`, `:options`) win over what the string says.

      iex> {:ok, spec} = MavRouter.Link.Spec.parse("tcp:[::1]:5760")
      iex> {spec.kind, spec.host, spec.port}
      {:tcp_client, {0, 0, 0, 0, 0, 0, 0, 1}, 5760}

      iex> {:error, error} = MavRouter.Link.Spec.parse("tcp:127.0.0.1")
      iex> Exception.message(error)
      ~s(cannot use "tcp:127.0.0.1" as a link: the port is missing; expected tcp:HOST:PORT, for example tcp:127.0.0.1:5760)
  """
  @spec parse(String.t(), keyword) :: {:ok, t} | {:error, Error.t()}
  def parse(text, overrides \\ []) do
    with {:error, reasons} <- read(text, overrides) do
      usual = [input: shown(text), expected: Transport.usage(), example: @example]
      {:error, struct!(Error, Keyword.merge(usual, without_login(reasons, text)))}
    end
  end

  defp shown(text) when is_binary(text), do: Address.shown(text)
  defp shown(other), do: other

  # A reason names the part that is wrong, and that may be a password.
  defp without_login(reasons, text) do
    if is_binary(text) and String.contains?(text, "@"),
      do: reasons |> Keyword.delete(:hint) |> Keyword.put(:reason, "a login is not possible in it"),
      else: reasons
  end

  @doc "As `parse/2`, raising the error."
  @spec parse!(String.t(), keyword) :: t
  def parse!(text, overrides \\ []) do
    case parse(text, overrides) do
      {:ok, spec} -> spec
      {:error, error} -> raise error
    end
  end

  @doc """
  The options that every string takes, as far as this one has them. A key of the configuration that says something else
  contradicts it. Empty for what is not a connection string.
  """
  @spec said(String.t()) :: %{optional(:id | :network | :secure | :gcs) => term}
  def said(text) do
    with [body, query] <- text |> String.trim() |> String.split("?", parts: 2),
         {transport, form} = Transport.form(body),
         {:ok, options, _foreign} <- Query.parse(query, transport, form) do
      Map.take(options, [:id, :network, :secure, :gcs])
    else
      _none -> %{}
    end
  end

  @doc """
  The specification of a link as the configuration has it (`MavRouter.Link.Settings`, `links`): `url` is required, the
  other keys may be left out. The error is a text.
  """
  @spec configured(map()) :: {:ok, t} | {:error, String.t()}
  def configured(%{url: url} = link) do
    with [] <- contradictions(link),
         {:ok, router} <- RuleKeys.owner_options(Map.new(link)),
         {:ok, spec} <-
           parse(url, id: link[:id], network: link[:network], options: configured_options(link, router)) do
      {:ok, spec}
    else
      {:error, error} when is_exception(error) -> {:error, Exception.message(error)}
      {:error, words} -> {:error, words}
      [{key, words} | _] -> {:error, "#{key}: #{words}"}
    end
  end

  @doc "The keys of which the connection string says something else, with words for that."
  @spec contradictions(map()) :: [{:id | :network | :secure | :gcs, String.t()}]
  def contradictions(%{url: url} = link) do
    for {key, said} <- Enum.sort(said(url)), link[key] != nil, link[key] != said do
      {key, "#{link[key]} contradicts #{key}=#{said} in the url"}
    end
  end

  defp configured_options(link, router) do
    [
      label: link[:label],
      high_latency: link[:high_latency] || false,
      secure: link[:secure] || false,
      router: router
    ]
  end

  @doc "Whether a link with the option `:secure` can be secure; the error is words."
  @spec secure(t) :: :ok | {:error, String.t()}
  def secure(%__MODULE__{options: %{secure: true}} = spec) do
    cond do
      spec.recorded ->
        {:error, "a recording is not secure: anybody could have made it"}

      spec.broadcast ->
        {:error, "a broadcast is not secure: everybody hears it"}

      spec.server and spec.host in [nil, {0, 0, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0}] ->
        {:error, "a server on all addresses is not secure: anybody reaches it"}

      true ->
        :ok
    end
  end

  def secure(_spec), do: :ok

  @doc "Where the link goes, for people: `127.0.0.1:5760`, `/dev/ttyACM0`, `flight.tlog`."
  @spec place(t) :: String.t()
  def place(%__MODULE__{host: nil, transport: transport} = spec), do: transport.place(spec)
  def place(%__MODULE__{host: host, port: port}), do: Address.format(host, port)

  defp read(text, overrides) do
    with :ok <- printable(text),
         trimmed = String.trim(text),
         :ok <- not_foreign(trimmed),
         [body | query] = String.split(trimmed, "?", parts: 2),
         {transport, form} = Transport.form(body),
         {:ok, options, foreign} <- Query.parse(List.first(query, ""), transport, form),
         {:ok, fields} <- fields(transport, form, body <> foreign),
         {:ok, named} <- named(options, overrides, body) do
      text = Query.without(foreign, trimmed, body, query)
      own = Map.drop(options, [:id, :network, :secure, :gcs])
      parts = [transport.traits(), fields, own, named, %{text: text, transport: transport}]
      parts |> Enum.reduce(&Map.merge(&2, &1)) |> then(&struct!(__MODULE__, &1)) |> checked()
    end
  end

  defp printable(text) do
    cond do
      not is_binary(text) ->
        {:error, reason: "it is not a string"}

      String.printable?(text) and byte_size(text) <= @max_bytes ->
        :ok

      true ->
        {:error,
         input: text |> shown() |> inspect() |> String.slice(0, 80), reason: "it is not a line of text"}
    end
  end

  defp not_foreign(text) do
    case Enum.find(@foreign, &String.starts_with?(text, &1)) do
      nil -> :ok
      prefix -> {:error, reason: "#{prefix} is another program's form", hint: "the forms are pymavlink's"}
    end
  end

  defp fields(transport, form, body) do
    rest = String.replace_prefix(body, form.prefix, "")

    case transport.parse(form.prefix, rest) do
      {:ok, fields} ->
        {:ok, fields}

      {:error, :unknown} ->
        {:error, reason: "it is neither a known kind of link nor a serial device", hint: hint(rest)}

      {:error, words} ->
        {:error, reason: words, expected: form.expected, example: form.example}
    end
  end

  defp hint(text) do
    case Address.parse(text, false) do
      {:ok, _host, _port} -> "write udpin:#{text} to listen there or udpout:#{text} to call it"
      {:error, _reason} -> nil
    end
  end

  # An id from the caller may be any text that is not empty: it is shown, never parsed.
  defp named(options, overrides, body) do
    id = overrides[:id] || Map.get(options, :id, body)
    network = overrides[:network] || Map.get(options, :network, MavRouter.Identity.default_network())
    tuning = overrides |> Keyword.get(:options, %{}) |> Map.new() |> Map.merge(Map.take(options, [:gcs]))
    tuning = if options[:secure], do: Map.put(tuning, :secure, true), else: tuning

    cond do
      not (is_binary(id) and id != "" and byte_size(id) <= @max_bytes) ->
        {:error, reason: "its id #{inspect(id)} is not a text", expected: "an id", example: "radio-a"}

      not Query.name?(network) ->
        {:error,
         reason: "#{inspect(network)} is not a valid network", expected: Query.name_form(), example: "radio-a"}

      true ->
        {:ok, %{id: id, network: network, options: tuning}}
    end
  end

  defp checked(spec) do
    with :ok <- secure(spec) do
      {:ok, spec}
    else
      {:error, words} ->
        {:error,
         reason: words,
         expected: "secure for a cable of its own",
         example: "udpin:192.168.144.10:14550?secure=true",
         hint: "take serial, loopback, or the address of the cable's own interface"}
    end
  end
end
