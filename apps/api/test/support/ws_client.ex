defmodule Aerie.WSClient do
  @moduledoc "A WebSocket client of a few lines, that can also do what a good one would not."

  import Bitwise

  defstruct [:module, :socket, :protocol, buffer: ""]

  @doc """
  Opens a WebSocket: the client, or the status and body of the refusal. Options: `:headers`, `:tls`.

  On a busy machine the server may give up a connection before the request is sent; then once more.
  """
  def open(port, path, options \\ []), do: Aerie.Patience.eventually(fn -> try_open(port, path, options) end)

  defp try_open(port, path, options) do
    {module, connect} =
      if options[:tls],
        do:
          {:ssl,
           &:ssl.connect(~c"localhost", port, [:binary, active: false, cacertfile: options[:tls]] ++ &1)},
        else: {:gen_tcp, &:gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false] ++ &1)}

    {:ok, socket} = connect.(options[:socket] || [])

    headers =
      [
        {"host", "127.0.0.1:#{port}"},
        {"upgrade", "websocket"},
        {"connection", "Upgrade"},
        {"sec-websocket-key", Base.encode64(:crypto.strong_rand_bytes(16))},
        {"sec-websocket-version", "13"}
      ]
      |> Map.new()
      |> Map.merge(Map.new(options[:headers] || []))

    lines = for {name, value} <- headers, value != nil, do: [name, ": ", value, "\r\n"]
    _ = module.send(socket, ["GET ", path, " HTTP/1.1\r\n", lines, "\r\n"])
    with {head, rest} <- head(module, socket, ""), do: opened(module, socket, head, rest)
  end

  defp opened(module, socket, head, rest) do
    ["HTTP/1.1 " <> <<status::binary-3, _::binary>> | lines] = String.split(head, "\r\n")
    headers = Map.new(lines, fn line -> line |> String.split(": ", parts: 2) |> List.to_tuple() end)

    case status do
      "101" ->
        %__MODULE__{module: module, socket: socket, buffer: rest, protocol: headers["sec-websocket-protocol"]}

      refused ->
        {String.to_integer(refused),
         body(module, socket, rest, String.to_integer(headers["content-length"] || "0"))}
    end
  end

  defp head(module, socket, got) do
    case String.split(got, "\r\n\r\n", parts: 2) do
      [head, rest] ->
        {head, rest}

      [_more] ->
        case module.recv(socket, 0, Aerie.Patience.ms()) do
          {:ok, bytes} -> head(module, socket, got <> bytes)
          {:error, _closed} when got == "" -> nil
        end
    end
  end

  defp body(_module, _socket, got, length) when byte_size(got) >= length,
    do: if(length > 0, do: JSON.decode!(binary_part(got, 0, length)))

  defp body(module, socket, got, length) do
    {:ok, bytes} = module.recv(socket, 0, Aerie.Patience.ms())
    body(module, socket, got <> bytes, length)
  end

  @doc "Sends one message."
  def send(client, payload, opcode \\ 2) do
    mask = :crypto.strong_rand_bytes(4)
    client.module.send(client.socket, [header(opcode, byte_size(payload)), mask, masked(payload, mask)])
  end

  defp header(opcode, size) when size < 126, do: <<1::1, 0::3, opcode::4, 1::1, size::7>>
  defp header(opcode, size) when size < 65_536, do: <<1::1, 0::3, opcode::4, 1::1, 126::7, size::16>>
  defp header(opcode, size), do: <<1::1, 0::3, opcode::4, 1::1, 127::7, size::64>>

  defp masked(payload, mask) do
    <<mask::32>> = mask

    for {<<byte>>, i} <- Enum.with_index(for(<<b::binary-1 <- payload>>, do: b)),
        into: "",
        do: <<bxor(byte, mask >>> (24 - 8 * rem(i, 4)) &&& 0xFF)>>
  end

  @doc "The next message: `{{opcode, payload}, client}`, or `{{:closed, reason}, client}`."
  def recv(client, timeout \\ Aerie.Patience.ms()) do
    case client.buffer do
      <<1::1, _::3, opcode::4, 0::1, 127::7, size::64, payload::binary-size(size), rest::binary>> ->
        {{opcode, payload}, %{client | buffer: rest}}

      <<1::1, _::3, opcode::4, 0::1, 126::7, size::16, payload::binary-size(size), rest::binary>> ->
        {{opcode, payload}, %{client | buffer: rest}}

      <<1::1, _::3, opcode::4, 0::1, size::7, payload::binary-size(size), rest::binary>> when size < 126 ->
        {{opcode, payload}, %{client | buffer: rest}}

      buffer ->
        case client.module.recv(client.socket, 0, timeout) do
          {:ok, bytes} -> recv(%{client | buffer: buffer <> bytes}, timeout)
          {:error, reason} -> {{:closed, reason}, client}
        end
    end
  end

  @doc "Closes the connection without a word."
  def close(client), do: client.module.close(client.socket)
end
