defmodule MavRouter.Link.Transport.WebSocket do
  @ping_ms 10_000

  @moduledoc """
  A WebSocket client: raw MAVLink in binary messages. It sends one frame in each message, and accepts any pieces of the
  stream. Over TLS (`wss://`) the server needs a certificate for its name from an authority of this system, or of the link's
  `ca` file.

  A silent server is pinged every #{div(@ping_ms, 1000)} s, ten times as rarely on a link of high latency; after three pings without
  any answer the connection is closed.

  Its connection strings are `ws://HOST[:PORT][/PATH]` (port 80 unless given) and `wss://…` (port 443). The URL may
  have a query of its own: options that are not ours are left to the server, and shown to nobody. `wss` takes
  `ca=FILE`: certificate authorities (PEM) instead of the system's.
  """
  @behaviour MavRouter.Link.Transport

  alias Aerie.Base.Net.Address
  alias MavRouter.Link.Transport.Form
  alias MavRouter.Link.Transport.Net
  alias Aerie.Base.Net.WebSocket.Frames
  alias Aerie.Base.Net.WebSocket.Handshake
  alias MavCodec.Frame

  @connect_ms 5_000
  @silent_pings 3

  @enforce_keys [:by, :socket, :early]
  defstruct [:by, :socket, :early, :timer, ping_ms: @ping_ms, frames: Frames.new(), silent: 0]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :websocket, framing: :stream, protocol: :tcp}

  @impl MavRouter.Link.Transport
  def forms do
    for {prefix, example, help} <- [
          {"ws://", "192.168.1.20:8765/", "connect to a WebSocket server"},
          {"wss://", "agent.example.org/mavlink", "the same with TLS (?ca=FILE: its authority)"}
        ] do
      form = Form.address(prefix, example, help, "HOST[:PORT][/PATH]")
      %{form | options: ["ca"], passes_query: true}
    end
  end

  @impl MavRouter.Link.Transport
  def parse(prefix, rest) do
    {authority, path} = authority(rest)
    tls? = prefix == "wss://"

    with :ok <- no_login(authority),
         :ok <- path(path),
         {:ok, fields} <- Form.parse_address(with_port(authority, tls?), false) do
      {:ok, Map.merge(fields, %{path: path, tls: tls?})}
    end
  end

  @impl MavRouter.Link.Transport
  def option("wss://", "ca", file) when file != "", do: {:ok, :ca, file}

  def option(_prefix, "ca", _file) do
    {:error,
     reason: ~s("ca" is not an option without TLS and a file),
     expected: "wss://HOST?ca=FILE",
     example: "wss://agent.example.org/mavlink?ca=/etc/ca.pem"}
  end

  defp authority(rest) do
    case String.split(rest, ~r{(?=[/?])}, parts: 2) do
      [authority] -> {authority, "/"}
      [authority, "?" <> _ = query] -> {authority, "/" <> query}
      [authority, path] -> {authority, path}
    end
  end

  defp no_login(authority) do
    if authority =~ "@", do: {:error, "a login is not possible in it"}, else: :ok
  end

  defp path(path) do
    cond do
      path =~ "#" -> {:error, "a WebSocket's URL has no fragment (#)"}
      path =~ ~r/\A[!-~]*\z/ -> :ok
      true -> {:error, "its path has characters that are written with % in a URL"}
    end
  end

  defp with_port(authority, tls?) do
    if authority == "" or authority =~ ~r/:[^\]]*\z/,
      do: authority,
      else: authority <> if(tls?, do: ":443", else: ":80")
  end

  @impl MavRouter.Link.Transport
  def open(spec) do
    with {:ok, addresses} <- Net.resolve(spec.host), {:ok, conn} <- connect(addresses, spec) do
      case shake(conn, spec) do
        {:ok, conn} -> {:ok, %{conn | ping_ms: @ping_ms * Net.patience(spec)}}
        {:error, reason} -> {conn.by.close(conn.socket), {:error, reason}} |> elem(1)
      end
    end
  end

  defp connect(addresses, spec) do
    Enum.reduce_while(addresses, {:error, :nxdomain}, fn address, _last ->
      case connect_to(address, spec) do
        {:ok, conn} -> {:halt, {:ok, conn}}
        {:error, reason} -> {:cont, {:error, explain_tls(reason, spec)}}
      end
    end)
  end

  defp connect_to(address, %{tls: false} = spec) do
    with {:ok, socket} <- Net.connect(address, spec.port, Net.tcp_options(spec), connect_ms(spec)),
         do: {:ok, %__MODULE__{by: :gen_tcp, socket: socket, early: ""}}
  end

  defp connect_to(address, %{tls: true} = spec) do
    with {:ok, trusted} <- trusted(spec.ca),
         {:ok, plain} <- Net.connect(address, spec.port, Net.tcp_options(spec), connect_ms(spec)),
         {:ok, socket} <- :ssl.connect(plain, trusted ++ name(spec.host) ++ checks(), connect_ms(spec)),
         do: {:ok, %__MODULE__{by: :ssl, socket: socket, early: ""}}
  end

  # Tests give a busy machine more time.
  defp connect_ms(spec), do: Map.get(spec.options, :connect_ms, @connect_ms)

  defp trusted(nil) do
    {:ok, cacerts: :public_key.cacerts_get()}
  rescue
    # Raised if the system has none.
    _none -> {:error, "this system has no certificate authorities; name some with ?ca=FILE"}
  end

  defp trusted(file) do
    if File.regular?(file),
      do: {:ok, cacertfile: file},
      else: {:error, "there is no file #{file} with certificate authorities"}
  end

  # For an address, the certificate has to name that address.
  defp name(host) when is_binary(host), do: [server_name_indication: String.to_charlist(host)]
  defp name(_address), do: []

  defp checks do
    match = [match_fun: :public_key.pkix_verify_hostname_match_fun(:https)]

    [
      verify: :verify_peer,
      depth: 5,
      versions: [:"tlsv1.3", :"tlsv1.2"],
      customize_hostname_check: match,
      log_level: :none
    ]
  end

  defp explain_tls({:tls_alert, {_name, text}}, spec) do
    text =
      text
      |> to_string()
      |> String.split(["\n", "TLS client:"])
      |> Enum.map_join(" ", &String.trim/1)
      |> String.trim()

    "#{Address.format(spec.host, spec.port)} is not trusted (TLS): #{text}"
  end

  defp explain_tls(reason, _spec), do: reason

  defp shake(conn, spec) do
    key = :cow_ws.key()

    with :ok <- conn.by.send(conn.socket, Handshake.request(spec, key)) do
      answer(conn, key, "", System.monotonic_time(:millisecond) + connect_ms(spec), spec)
    end
  end

  defp answer(conn, key, before, deadline, spec) do
    with {:ok, bytes} <- conn.by.recv(conn.socket, 0, max(deadline - System.monotonic_time(:millisecond), 0)) do
      case Handshake.answer(before <> bytes, key) do
        {:ok, rest} -> {:ok, %{conn | early: rest}}
        :more -> answer(conn, key, before <> bytes, deadline, spec)
        {:error, words} -> {:error, "no WebSocket at #{Address.format(spec.host, spec.port)}: #{words}"}
      end
    end
  end

  @impl MavRouter.Link.Transport
  def give(%{by: by, socket: socket}, link), do: by.controlling_process(socket, link)

  @impl MavRouter.Link.Transport
  def activate(%{socket: socket} = conn) do
    with {:ok, {address, port}} <- options(conn).peername(socket),
         {:ok, {own, own_port}} <- options(conn).sockname(socket),
         :ok <- options(conn).setopts(socket, active: Net.active()) do
      # Data that came together with the answer is handled like any other message.
      if conn.early != "", do: send(self(), {:websocket, :early, socket})

      {:ok, ping_later(conn),
       %{local: Address.format(own, own_port), port: own_port, peer: Address.format(address, port)}}
    end
  end

  defp options(%{by: :ssl}), do: :ssl
  defp options(%{by: :gen_tcp}), do: :inet

  defp ping_later(conn),
    do: %{conn | timer: Process.send_after(self(), {:websocket, :ping, conn.socket}, conn.ping_ms)}

  @impl MavRouter.Link.Transport
  def handle(%{socket: socket} = conn, {:websocket, :early, socket}),
    do: read(%{conn | early: ""}, conn.early)

  def handle(%{socket: socket} = conn, {kind, socket, bytes}) when kind in [:tcp, :ssl] and is_binary(bytes),
    do: read(conn, bytes)

  def handle(%{socket: socket} = conn, {kind, socket}) when kind in [:tcp_passive, :ssl_passive] do
    # If the socket closed meanwhile, its next message says so.
    _ = options(conn).setopts(socket, active: Net.active())
    {[], conn}
  end

  def handle(%{socket: socket} = conn, {:websocket, :ping, socket}) do
    if conn.silent >= @silent_pings do
      {[{:closed, :timeout}], conn}
    else
      _ = put(conn, Frames.control(:ping))
      {[], ping_later(%{conn | silent: conn.silent + 1})}
    end
  end

  def handle(%{socket: socket} = conn, {kind, socket}) when kind in [:tcp_closed, :ssl_closed],
    do: {[{:closed, :closed}], conn}

  def handle(%{socket: socket} = conn, {kind, socket, reason}) when kind in [:tcp_error, :ssl_error],
    do: {[{:closed, reason}], conn}

  def handle(_conn, _message), do: :unknown

  defp read(conn, bytes) do
    {events, frames} = Frames.push(conn.frames, bytes)
    conn = %{conn | frames: frames, silent: 0}
    # One read is one delivery.
    data = for {:data, data} <- events, do: data
    # If the socket does not accept the pong, the next write finds out.
    for {:ping, payload} <- events, do: _ = put(conn, Frames.control({:pong, payload}))
    reads = if data == [], do: [], else: [{:read, [{:remote, joined(data)}]}]
    {reads ++ Enum.flat_map(events, &ending/1), conn}
  end

  defp joined([data]), do: data
  defp joined(data), do: IO.iodata_to_binary(data)

  defp ending({:close, code, text}) do
    said = if String.valid?(text) and text != "", do: ": #{String.slice(text, 0, 100)}", else: ""
    [{:closed, "the server closed the WebSocket (#{code || "no code"}#{said})"}]
  end

  defp ending(:bad), do: [{:closed, "the server sent something other than a WebSocket frame"}]
  defp ending(_other), do: []

  @impl MavRouter.Link.Transport
  def write(conn, _peer, bytes) do
    messages = bytes |> IO.iodata_to_binary() |> frames() |> Enum.map(&Frames.message/1)

    case put(conn, messages) do
      :ok -> {:ok, conn}
      :busy -> {:busy, conn}
      {:error, reason} -> {:error, reason, conn}
    end
  end

  # One message for each frame: some receivers read only the first frame of a message.
  defp frames(<<>>), do: []

  defp frames(bytes) do
    with {:ok, _header, _payload, total, _id, _system} when total < byte_size(bytes) <- Frame.header(bytes) do
      <<frame::binary-size(^total), rest::binary>> = bytes
      [frame | frames(rest)]
    else
      _last_or_other -> [bytes]
    end
  end

  defp put(%{by: :gen_tcp, socket: socket}, bytes), do: Net.tcp_write(socket, bytes)

  defp put(%{by: :ssl, socket: socket}, bytes) do
    case :ssl.getstat(socket, [:send_pend]) do
      {:ok, [send_pend: waiting]} -> if Net.room?(waiting), do: :ssl.send(socket, bytes), else: :busy
      {:error, reason} -> {:error, reason}
    end
  end

  @impl MavRouter.Link.Transport
  def close(%{by: by, socket: socket} = conn) do
    _ = conn.timer && Process.cancel_timer(conn.timer)
    _ = put(conn, Frames.control({:close, 1001, ""}))
    _ = if by == :ssl, do: :ssl.close(socket), else: Net.tcp_close(socket)
    :ok
  end
end
