defmodule ConsoleBench.Viewer do
  @moduledoc "A page as a browser has it: GET, join, and every frame read and inflated. Runs in a VM of its own."

  def run(port, cookie, until) do
    {html, _socket} = get(port, cookie)
    [_, csrf] = Regex.run(~r/name="csrf-token" content="([^"]+)"/, html)
    [_, id] = Regex.run(~r/id="(phx-[^"]+)" data-phx-main/, html)
    [_, session] = Regex.run(~r/data-phx-session="([^"]+)"/, html)
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, packet: :raw])
    query = URI.encode_query(%{"_csrf_token" => csrf, "vsn" => "2.0.0"})

    :ok =
      :gen_tcp.send(socket, [
        "GET /live/websocket?#{query} HTTP/1.1\r\nhost: 127.0.0.1:#{port}\r\nupgrade: websocket\r\nconnection: upgrade\r\n",
        "sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n",
        "sec-websocket-extensions: permessage-deflate\r\ncookie: #{cookie}\r\n\r\n"
      ])

    rest = head(socket, "")

    join = %{
      url: "http://127.0.0.1:#{port}/?view=table",
      params: %{_mounts: 0, _csrf_token: csrf},
      session: session,
      static: nil
    }

    :ok = :gen_tcp.send(socket, masked(JSON.encode!(["4", "4", "lv:" <> id, "phx_join", join])))
    z = :zlib.open()
    :ok = :zlib.inflateInit(z, -15)
    read(socket, rest, z, until, %{bytes: 0, frames: 0, mode: [], numbers: []})
  end

  defp get(port, cookie) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])

    :ok =
      :gen_tcp.send(
        socket,
        "GET /?view=table HTTP/1.1\r\nhost: 127.0.0.1:#{port}\r\nconnection: close\r\ncookie: #{cookie}\r\n\r\n"
      )

    {all(socket, ""), socket}
  end

  defp all(socket, got) do
    case :gen_tcp.recv(socket, 0, 60_000) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> got
    end
  end

  defp head(socket, got) do
    case String.split(got, "\r\n\r\n", parts: 2) do
      ["HTTP/1.1 101" <> _head, rest] ->
        rest

      _more ->
        {:ok, bytes} = :gen_tcp.recv(socket, 0, 60_000)
        head(socket, got <> bytes)
    end
  end

  # The mask may be zero; the server does not mind.
  defp masked(text) when byte_size(text) < 126, do: [<<0x81, 0x80 + byte_size(text), 0::32>>, text]
  defp masked(text), do: [<<0x81, 0x80 + 126, byte_size(text)::16, 0::32>>, text]

  defp read(socket, buffer, z, until, sum) do
    case frame(buffer) do
      {rsv, payload, rest} ->
        now = System.os_time(:microsecond)

        text =
          if rsv == 1,
            do: z |> :zlib.inflate([payload, <<0, 0, 255, 255>>]) |> IO.iodata_to_binary(),
            else: payload

        late =
          for [_all, what, at] <- Regex.scan(~r/([MN])(\d{16})/, text),
              do: {what, now - String.to_integer(at)}

        # The page as it was when the viewer came has old marks.
        late = if sum.frames < 3, do: [], else: late

        sum = %{
          bytes: sum.bytes + byte_size(payload) + 4,
          frames: sum.frames + 1,
          mode: for({"M", us} <- late, do: us) ++ sum.mode,
          numbers: for({"N", us} <- late, do: us) ++ sum.numbers
        }

        read(socket, rest, z, until, sum)

      :more ->
        left = until - System.os_time(:millisecond)

        case if(left > 0, do: :gen_tcp.recv(socket, 0, left), else: {:error, :timeout}) do
          {:ok, bytes} -> read(socket, buffer <> bytes, z, until, sum)
          {:error, _over} -> sum
        end
    end
  end

  defp frame(<<1::1, rsv::3, _op::4, 0::1, 127::7, n::64, payload::binary-size(n), rest::binary>>),
    do: {min(rsv, 1), payload, rest}

  defp frame(<<1::1, rsv::3, _op::4, 0::1, 126::7, n::16, payload::binary-size(n), rest::binary>>),
    do: {min(rsv, 1), payload, rest}

  defp frame(<<1::1, rsv::3, _op::4, 0::1, n::7, payload::binary-size(n), rest::binary>>) when n < 126,
    do: {min(rsv, 1), payload, rest}

  defp frame(_more), do: :more
end
