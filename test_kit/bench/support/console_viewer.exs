Code.require_file("socket.ex", __DIR__)

defmodule Bench.Viewer do
  @moduledoc "A page as a browser has it: GET, join, and every frame read and inflated. Runs in a VM of its own."

  alias Bench.Socket

  def run(port, cookie, until) do
    html = get(port, cookie)
    [_, csrf] = Regex.run(~r/name="csrf-token" content="([^"]+)"/, html)
    [_, id] = Regex.run(~r/id="(phx-[^"]+)" data-phx-main/, html)
    [_, session] = Regex.run(~r/data-phx-session="([^"]+)"/, html)
    query = URI.encode_query(%{"_csrf_token" => csrf, "vsn" => "2.0.0"})
    headers = "sec-websocket-extensions: permessage-deflate\r\ncookie: #{cookie}\r\n"
    {socket, rest} = Socket.upgrade(port, "/live/websocket?#{query}", headers)
    url = "http://127.0.0.1:#{port}/"
    join = %{url: url, params: %{_mounts: 0, _csrf_token: csrf}, session: session, static: nil}
    :ok = :gen_tcp.send(socket, masked(JSON.encode!(["4", "4", "lv:" <> id, "phx_join", join])))
    z = :zlib.open()
    :ok = :zlib.inflateInit(z, -15)
    read(socket, rest, z, until, %{bytes: 0, frames: 0, mode: [], numbers: []})
  end

  defp get(port, cookie) do
    socket = Socket.open({:tcp, port})

    head =
      "GET / HTTP/1.1\r\nhost: 127.0.0.1:#{port}\r\nconnection: close\r\ncookie: #{cookie}\r\n\r\n"

    :ok = :gen_tcp.send(socket, head)
    Socket.all(socket)
  end

  # The mask may be zero; the server does not mind.
  defp masked(text) when byte_size(text) < 126, do: [<<0x81, 0x80 + byte_size(text), 0::32>>, text]
  defp masked(text), do: [<<0x81, 0x80 + 126, byte_size(text)::16, 0::32>>, text]

  defp read(socket, buffer, z, until, sum) do
    case frame(buffer) do
      {compressed?, payload, rest} ->
        now = System.os_time(:microsecond)
        read(socket, rest, z, until, count(sum, payload, late(text(compressed?, payload, z), now)))

      :more ->
        left = until - System.os_time(:millisecond)

        case if(left > 0, do: :gen_tcp.recv(socket, 0, left), else: {:error, :timeout}) do
          {:ok, bytes} -> read(socket, buffer <> bytes, z, until, sum)
          {:error, _over} -> sum
        end
    end
  end

  defp text(true, payload, z), do: z |> :zlib.inflate([payload, <<0, 0, 255, 255>>]) |> IO.iodata_to_binary()
  defp text(false, payload, _z), do: payload

  defp late(text, now) do
    for [_all, what, at] <- Regex.scan(~r/([MN])(\d{16})/, text), do: {what, now - String.to_integer(at)}
  end

  # The page as it was when the viewer came has old marks.
  defp count(sum, payload, late) do
    late = if sum.frames < 3, do: [], else: late

    %{
      bytes: sum.bytes + byte_size(payload) + 4,
      frames: sum.frames + 1,
      mode: for({"M", us} <- late, do: us) ++ sum.mode,
      numbers: for({"N", us} <- late, do: us) ++ sum.numbers
    }
  end

  defp frame(<<_fin::1, rsv::3, _op::4, 0::1, 127::7, n::64, payload::binary-size(n), rest::binary>>),
    do: {rsv > 0, payload, rest}

  defp frame(<<_fin::1, rsv::3, _op::4, 0::1, 126::7, n::16, payload::binary-size(n), rest::binary>>),
    do: {rsv > 0, payload, rest}

  defp frame(<<_fin::1, rsv::3, _op::4, 0::1, n::7, payload::binary-size(n), rest::binary>>) when n < 126,
    do: {rsv > 0, payload, rest}

  defp frame(_more), do: :more
end
