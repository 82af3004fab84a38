defmodule Aerie.Link.Spec do
  @moduledoc """
  What a link is to be, validated: the meaning of a connection string.

  The strings are pymavlink's, so that what works with MAVProxy works here:

  | string | kind | meaning |
  |---|---|---|
  | `udpin:HOST:PORT`, `udp:HOST:PORT` | `:udp_server` | listens; every sender is a peer of its own |
  | `udpout:HOST:PORT` | `:udp_client` | sends to that address, hears what answers |
  | `udpbcast:ADDRESS:PORT` | `:udp_client` | sends to a broadcast address until one answers, then to that one |
  | `tcp:HOST:PORT` | `:tcp_client` | connects, and again after every fault |
  | `tcpin:HOST:PORT` | `:tcp_server` | accepts many |
  | `ws://HOST/PATH`, `wss://HOST:PORT/PATH` | `:websocket` | calls a WebSocket server that sends raw MAVLink in binary messages; port 80 and 443 unless said |
  | `DEVICE` or `DEVICE,BAUD` | `:serial` | a serial port, 115200 baud unless said |
  | `serial:DEVICE` | `:serial` | a serial port whose baud rate is found by listening |
  | `serial:auto` | `:serial` | the first serial port with a vehicle behind it (`Aerie.Link.Serial.Detector`) |
  | `replay:FILE` | `:replay` | a recorded tlog, `?speed=1` (real time), `?speed=10`, `?speed=max`, `&loop=true` |

  HOST is an IPv4 address, an IPv6 address in brackets (`[::1]`) or a name; a name is resolved again on every
  connection attempt. A server's empty HOST means all IPv4 addresses, and its port 0 means any free one.

  Those that are found by listening take `?bauds=57600,921600` (candidates instead of the usual ones), and `serial:auto` takes
  `&ports=/dev/ttyAMA0,/dev/ttyUSB3` (looked at first) and `&only=true` (no others).

  A WebSocket's URL may have a query of its own; what is not listed here is left to the server, and shown to nobody. `wss` takes
  `&ca=FILE`, certificate authorities (PEM) instead of the system's.

  Every string takes `?network=NAME` (whose system ids it shares, default `"main"`) and `&id=NAME` (the identity of
  the link, default: the string without its options). `&secure=true` says that nobody but the two ends can hear or
  reach it (USB, a cable of its own, loopback): a vehicle may be given its signing key there and is believed unsigned. It
  is refused for what cannot be such a cable: a broadcast, a recording, a server on all addresses. `&gcs=allow` lets
  whoever reaches the link command vehicles, `&gcs=deny` nobody, this machine neither (`Aerie.Router.Gate`).
  """

  alias Aerie.Address
  alias Aerie.Link.Spec.Error

  @kinds [:udp_server, :udp_client, :tcp_client, :tcp_server, :websocket, :serial, :replay]

  @enforce_keys [:id, :kind, :text]
  defstruct [
    :id,
    :kind,
    :text,
    :host,
    :port,
    :device,
    :file,
    :detect,
    :bauds,
    :ca,
    path: "/",
    tls: false,
    ports: [],
    only: false,
    network: "main",
    baud: 115_200,
    broadcast: false,
    speed: 1.0,
    loop: false,
    options: %{}
  ]

  @type kind :: :udp_server | :udp_client | :tcp_client | :tcp_server | :websocket | :serial | :replay

  @typedoc """
  - `id`: identity of the link, unique in a gateway; it outlives restarts and reconnections
  - `text`: the connection string as given
  - `host`, `port`: UDP and TCP; a host that is a string is a name still to be resolved
  - `path` (with the query), `tls`, `ca`: WebSocket
  - `device`, `baud`: serial; `detect` is what is found by listening, nil for neither, `:baud`, or `:port` for both
  - `bauds`, `ports`, `only`: candidates for that, nil and none unless said
  - `file`, `speed` (factor of real time, or `:max`), `loop`: replay
  - `network`: links of one network share one space of system ids
  - `options`: tuning of the link (`Aerie.Link.Options`), not part of the string
  """
  @type t :: %__MODULE__{
          id: String.t(),
          kind: kind,
          text: String.t(),
          network: String.t(),
          host: :inet.ip_address() | String.t() | nil,
          port: :inet.port_number() | nil,
          path: String.t(),
          tls: boolean,
          ca: Path.t() | nil,
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

  @forms [
    {"udpin:", :udp_server, "udpin:HOST:PORT", "udpin:0.0.0.0:14550"},
    {"udp:", :udp_server, "udp:HOST:PORT", "udp:0.0.0.0:14550"},
    {"udpout:", :udp_client, "udpout:HOST:PORT", "udpout:192.168.1.10:14550"},
    {"udpbcast:", :udp_broadcast, "udpbcast:ADDRESS:PORT", "udpbcast:192.168.1.255:14550"},
    {"tcp:", :tcp_client, "tcp:HOST:PORT", "tcp:127.0.0.1:5760"},
    {"tcpin:", :tcp_server, "tcpin:HOST:PORT", "tcpin:0.0.0.0:5760"},
    {"ws://", :websocket, "ws://HOST[:PORT][/PATH]", "ws://192.168.1.20:8765/"},
    {"wss://", :websocket, "wss://HOST[:PORT][/PATH]", "wss://agent.example.org/mavlink"},
    {"replay:", :replay, "replay:FILE?speed=N|max", "replay:flight.tlog?speed=max"},
    {"serial:", :serial, "serial:auto, serial:DEVICE or serial:DEVICE,BAUD", "serial:auto"}
  ]
  @serial_form "DEVICE or DEVICE,BAUD"
  @serial_example "/dev/ttyACM0,115200"
  @any_form "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, ws://HOST/PATH, replay:FILE, DEVICE,BAUD or serial:auto"
  @foreign ~w(udp:// udpin:// udpout:// tcp:// tcpin:// tcpout:// serial:// file: http:// https://)
  @rates 50..20_000_000
  @max_candidates 20
  # Options of every string.
  @common ~w(network id secure gcs)
  @name ~r/\A[A-Za-z0-9_-]{1,64}\z/

  @doc "The kinds of links there are."
  @spec kinds() :: [kind]
  def kinds, do: @kinds

  @doc """
  Reads a connection string. `overrides` (`:id`, `:network`, `:options`) win over what the string says.

      iex> {:ok, spec} = Aerie.Link.Spec.parse("tcp:[::1]:5760")
      iex> {spec.kind, spec.host, spec.port}
      {:tcp_client, {0, 0, 0, 0, 0, 0, 0, 1}, 5760}

      iex> {:error, error} = Aerie.Link.Spec.parse("tcp:127.0.0.1")
      iex> Exception.message(error)
      ~s(cannot use "tcp:127.0.0.1" as a link: the port is missing; expected tcp:HOST:PORT, for example tcp:127.0.0.1:5760)
  """
  @spec parse(String.t(), keyword) :: {:ok, t} | {:error, Error.t()}
  def parse(text, overrides \\ [])

  def parse(text, overrides) when is_binary(text) do
    trimmed = String.trim(text)

    with :ok <- printable(text),
         :ok <- not_foreign(trimmed),
         {body, query} = split_query(trimmed),
         form = form(body),
         {query, foreign} = foreign(query, form),
         {:ok, options} <- options(query, form, text),
         {:ok, fields} <- fields(form, body <> foreign, text),
         {:ok, named} <- named(options, overrides, body, form, text) do
      fields =
        fields
        |> Map.merge(Map.take(options, [:speed, :loop, :bauds, :ports, :only, :ca]))
        |> Map.merge(named)

      spec = struct!(__MODULE__, Map.put(fields, :text, shown(trimmed, body, query, foreign)))

      case secure(spec) do
        :ok ->
          {:ok, spec}

        {:error, reason} ->
          error(text, reason, "secure for a cable of its own", "udpin:192.168.144.10:14550?secure=true",
            hint: "take serial, loopback, or the address of the cable's own interface"
          )
      end
    end
  end

  def parse(other, _overrides) do
    error(other, "it is not a string", @any_form, "udpin:0.0.0.0:14550")
  end

  @doc "Whether a link that is marked secure can be (the option `:secure`); the error is words."
  @spec secure(t) :: :ok | {:error, String.t()}
  def secure(%__MODULE__{options: %{secure: true}} = spec) do
    cond do
      spec.kind == :replay ->
        {:error, "a recording is not secure: anybody could have made it"}

      spec.broadcast ->
        {:error, "a broadcast is not secure: everybody hears it"}

      spec.kind in [:udp_server, :tcp_server] and spec.host in [nil, {0, 0, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0}] ->
        {:error, "a server on all addresses is not secure: anybody reaches it"}

      true ->
        :ok
    end
  end

  def secure(_spec), do: :ok

  @doc "As `parse/2`, raising the error."
  @spec parse!(String.t(), keyword) :: t
  def parse!(text, overrides \\ []) do
    case parse(text, overrides) do
      {:ok, spec} -> spec
      {:error, error} -> raise error
    end
  end

  @doc "Where the link goes, for people: `127.0.0.1:5760`, `/dev/ttyACM0`, `flight.tlog`."
  @spec place(t) :: String.t()
  def place(%__MODULE__{kind: :serial, detect: :port}), do: "any serial port"
  def place(%__MODULE__{kind: :serial, device: device}), do: device
  def place(%__MODULE__{kind: :replay, file: file}), do: Path.basename(file)
  def place(%__MODULE__{host: host, port: port}), do: Address.format(host, port)

  defp printable(text) do
    if String.printable?(text) and byte_size(text) <= 4096 do
      :ok
    else
      error(String.slice(inspect(text), 0, 80), "it is not a line of text", @any_form, "udpin:0.0.0.0:14550")
    end
  end

  defp not_foreign(text) do
    case Enum.find(@foreign, &String.starts_with?(text, &1)) do
      nil ->
        :ok

      prefix ->
        error(text, "#{prefix} is another program's form", @any_form, "udpin:0.0.0.0:14550",
          hint: "the forms are pymavlink's"
        )
    end
  end

  defp split_query(text) do
    case String.split(text, "?", parts: 2) do
      [body, query] -> {body, query}
      [body] -> {body, ""}
    end
  end

  # Of a WebSocket's query what is not ours is the server's.
  defp foreign(query, {_prefix, :websocket, _form, _example}) do
    {ours, theirs} =
      query
      |> String.split("&", trim: true)
      |> Enum.split_with(&(hd(String.split(&1, "=")) in (@common ++ ["ca"])))

    {Enum.join(ours, "&"), if(theirs == [], do: "", else: "?" <> Enum.join(theirs, "&"))}
  end

  defp foreign(query, _form), do: {query, ""}

  # What a server wants to be told may be a password.
  defp shown(text, _body, _query, ""), do: text
  defp shown(_text, body, "", _foreign), do: body <> "?…"
  defp shown(_text, body, query, _foreign), do: body <> "?…&" <> query

  defp form(body) do
    Enum.find(@forms, fn {prefix, _kind, _form, _example} -> String.starts_with?(body, prefix) end)
  end

  defp fields({prefix, :replay, expected, example}, body, text) do
    case String.replace_prefix(body, prefix, "") do
      "" -> error(text, "the file is missing", expected, example)
      file -> {:ok, %{kind: :replay, file: file}}
    end
  end

  defp fields({"serial:", :serial, _expected, _example}, "serial:auto", _text) do
    {:ok, %{kind: :serial, detect: :port}}
  end

  defp fields({"serial:", :serial, expected, example}, "serial:" <> device, text) do
    with {:ok, fields} <- fields(nil, device, text) do
      detect = if String.contains?(device, ","), do: nil, else: :baud
      {:ok, Map.put(fields, :detect, detect)}
    else
      {:error, %{reason: reason}} -> error(text, reason, expected, example)
    end
  end

  defp fields({prefix, :websocket, expected, example}, body, text) do
    {authority, path} = body |> String.replace_prefix(prefix, "") |> authority()

    with :ok <- nobody(authority),
         :ok <- path(path),
         {:ok, host, port} <- Address.parse(with_port(authority, prefix), false) do
      {:ok, %{kind: :websocket, host: host, port: port, path: path, tls: prefix == "wss://"}}
    else
      {:error, reason} -> error(text, reason, expected, example)
    end
  end

  defp fields({prefix, kind, expected, example}, body, text) do
    server? = kind in [:udp_server, :tcp_server]

    case Address.parse(String.replace_prefix(body, prefix, ""), server?) do
      {:ok, host, port} -> {:ok, address_fields(kind, host, port)}
      {:error, reason} -> error(text, reason, expected, example)
    end
  end

  defp fields(nil, body, text) do
    case String.split(body, ",") do
      [device] -> serial_fields(device, nil, text)
      [device, baud] -> serial_fields(device, baud, text)
      _more -> error(text, "there are too many commas", @serial_form, @serial_example)
    end
  end

  defp authority(rest) do
    case String.split(rest, ~r{(?=[/?])}, parts: 2) do
      [authority] -> {authority, "/"}
      [authority, "?" <> _ = query] -> {authority, "/" <> query}
      [authority, path] -> {authority, path}
    end
  end

  defp nobody(authority) do
    if authority =~ "@", do: {:error, "a login is not possible in it"}, else: :ok
  end

  defp path(path) do
    cond do
      path =~ "#" -> {:error, "a WebSocket's URL has no fragment (#)"}
      path =~ ~r/\A[!-~]*\z/ -> :ok
      true -> {:error, "its path has characters that are written with % in a URL"}
    end
  end

  defp with_port(authority, prefix) do
    if authority == "" or authority =~ ~r/:[^\]]*\z/,
      do: authority,
      else: authority <> if(prefix == "wss://", do: ":443", else: ":80")
  end

  defp address_fields(:udp_broadcast, host, port) do
    %{kind: :udp_client, broadcast: true, host: host, port: port}
  end

  defp address_fields(kind, host, port), do: %{kind: kind, host: host, port: port}

  defp serial_fields(device, baud, text) do
    cond do
      not device?(device) ->
        error(
          text,
          "it is neither a known kind of link nor a serial device",
          @any_form,
          "udpin:0.0.0.0:14550",
          hint: bare_hint(device)
        )

      is_nil(baud) ->
        {:ok, %{kind: :serial, device: device}}

      true ->
        case Integer.parse(baud) do
          {rate, ""} when rate in @rates -> {:ok, %{kind: :serial, device: device, baud: rate}}
          _other -> error(text, "#{inspect(baud)} is no baud rate", @serial_form, @serial_example)
        end
    end
  end

  defp device?("/" <> rest), do: rest != ""
  defp device?(name), do: name =~ ~r/\A(tty|cu\.|rfcomm|COM)[\w.-]+\z/

  defp bare_hint(text) do
    case Address.parse(text, false) do
      {:ok, _host, _port} -> "write udpin:#{text} to listen there or udpout:#{text} to call it"
      {:error, _reason} -> nil
    end
  end

  defp options("", _form, _text), do: {:ok, %{}}

  defp options(query, form, text) do
    query
    |> String.split("&", trim: true)
    |> Enum.reduce_while({:ok, %{}}, fn pair, {:ok, options} ->
      [key | value] = String.split(pair, "=", parts: 2)

      case option(key, List.first(value) || "", form) do
        {:ok, name, value} -> {:cont, {:ok, Map.put(options, name, value)}}
        {:error, reason, expected, example} -> {:halt, error(text, reason, expected, example)}
      end
    end)
  end

  defp option("speed", value, {_prefix, :replay, _expected, _example}) do
    with :error <- speed(value) do
      {:error, "#{inspect(value)} is no speed", "speed=N (0.01 to 10000) or speed=max",
       "replay:flight.tlog?speed=10"}
    end
  end

  defp option("loop", value, {_prefix, :replay, _expected, _example}) when value in ["true", "false"] do
    {:ok, :loop, value == "true"}
  end

  defp option("bauds", value, {_prefix, :serial, _expected, _example}) do
    rates = for text <- String.split(value, ","), do: Integer.parse(text)

    if length(rates) <= @max_candidates and Enum.all?(rates, &match?({rate, ""} when rate in @rates, &1)),
      do: {:ok, :bauds, Enum.map(rates, &elem(&1, 0))},
      else:
        {:error, "#{inspect(value)} are no baud rates",
         "up to #{@max_candidates} rates with commas between them", "serial:auto?bauds=57600,921600"}
  end

  defp option("ports", value, {_prefix, :serial, _expected, _example}) do
    ports = String.split(value, ",")

    if length(ports) <= @max_candidates and Enum.all?(ports, &device?/1),
      do: {:ok, :ports, ports},
      else:
        {:error, "#{inspect(value)} are no serial ports",
         "up to #{@max_candidates} ports with commas between them",
         "serial:auto?ports=/dev/ttyAMA0,/dev/ttyUSB0"}
  end

  defp option("only", value, {_prefix, :serial, _expected, _example}) when value in ["true", "false"] do
    {:ok, :only, value == "true"}
  end

  defp option("ca", file, {"wss://", _kind, _expected, _example}) when file != "", do: {:ok, :ca, file}

  defp option("secure", value, _form) when value in ["true", "false"], do: {:ok, :secure, value == "true"}

  defp option("gcs", value, _form) when value in ["auto", "allow", "deny"],
    do: {:ok, :gcs, String.to_existing_atom(value)}

  defp option("network", value, _form), do: name(:network, value)
  defp option("id", value, _form), do: name(:id, value)

  defp option(key, value, {_prefix, :replay, _expected, _example}) do
    {:error, "#{key}=#{value} is no option of a replay", "the options speed, loop, network and id",
     "replay:flight.tlog?speed=max&loop=true"}
  end

  defp option(key, _value, _form) do
    {:error, "#{inspect(key)} is no option", "the options network, id, secure and gcs",
     "udpin:0.0.0.0:14550?network=radio-a"}
  end

  defp name(key, value) do
    if value =~ @name do
      {:ok, key, value}
    else
      {:error, "#{inspect(value)} is no #{key}", "up to 64 letters, digits, - or _",
       "udpin:0.0.0.0:14550?#{key}=radio-a"}
    end
  end

  defp speed("max"), do: {:ok, :speed, :max}

  defp speed(value) do
    case Float.parse(value) do
      {number, ""} when number >= 0.01 and number <= 10_000 -> {:ok, :speed, number}
      _other -> :error
    end
  end

  # An id from the caller may be any text that is not empty: it is shown, never parsed.
  defp named(options, overrides, body, _form, text) do
    id = Keyword.get(overrides, :id) || Map.get(options, :id, body)
    network = Keyword.get(overrides, :network) || Map.get(options, :network, "main")

    cond do
      not (is_binary(id) and id != "" and byte_size(id) <= 4096) ->
        error(text, "its id #{inspect(id)} is no text", "an id", "radio-a")

      not (is_binary(network) and network =~ @name) ->
        error(text, "#{inspect(network)} is no network", "up to 64 letters, digits, - or _", "radio-a")

      true ->
        given = Map.new(Keyword.get(overrides, :options, %{}))

        {:ok,
         %{id: id, network: network, options: Map.merge(given, Map.take(options, [:gcs]) |> secured(options))}}
    end
  end

  defp secured(given, %{secure: true}), do: Map.put(given, :secure, true)
  defp secured(given, _unsaid), do: given

  defp error(input, reason, expected, example, more \\ []) do
    {:error, struct!(Error, [input: input, reason: reason, expected: expected, example: example] ++ more)}
  end
end
