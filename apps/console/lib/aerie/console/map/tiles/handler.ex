defmodule Aerie.Console.Map.Tiles.Handler do
  @moduledoc """
  Serves `Aerie.Console.Map.Tiles` to signed-in users: a tile, whose path consists of three numbers, or a range of the
  PMTiles file (RFC 9110, section 14).
  """

  @behaviour :cowboy_handler

  alias Aerie.Access.HTTP.{Admission, Request}
  alias Aerie.Access.Session
  alias Aerie.Console.Map.Tiles
  alias Phoenix.LiveView.Cookie

  # More than any directory or tile has.
  @longest 16 * 1_048_576

  @impl :cowboy_handler
  def init(request, %{gateway: gateway, policy: policy, server: server} = state) do
    session = Cookie.read(request, server.secret, server.cookie)

    found =
      with :ok <- Admission.host(policy, Request.facts(request)),
           %{} <- Session.user(gateway, session) do
        if state[:archive],
          do: range(Tiles.archive(gateway), request),
          else: tile(gateway, Enum.map([:z, :x, :y], &number(:cowboy_req.binding(&1, request))))
      else
        nil -> 401
        {:error, error} -> error.status
      end

    {:ok, answer(request, found), state}
  end

  defp tile(gateway, [z, x, y]) when is_integer(z) and is_integer(x) and is_integer(y),
    do: Tiles.tile(gateway, z, x, y) || 404

  defp tile(_gateway, _others), do: 404

  defp number(text) when byte_size(text) <= 9 do
    case Integer.parse(text) do
      {number, ""} when number >= 0 -> number
      _other -> nil
    end
  end

  defp number(_long), do: nil

  defp range(nil, _request), do: 404

  defp range(path, request) do
    with {:ok, %File.Stat{size: size} = stat} <- File.stat(path, time: :posix),
         {:bytes, [{from, to}]} when is_integer(from) and is_integer(to) <- asked(request),
         to = min(to, size - 1),
         true <- from <= to and to - from < @longest do
      {:range, path, from, to, stat}
    else
      {:error, _posix} -> 404
      _not_one_range -> 416
    end
  end

  defp asked(request) do
    :cowboy_req.parse_header("range", request)
  catch
    _kind, _malformed -> nil
  end

  defp answer(request, {bytes, type, gzip?}) do
    more = if gzip?, do: %{"content-encoding" => "gzip"}, else: %{}
    :cowboy_req.reply(200, headers(type, more), bytes, request)
  end

  defp answer(request, {:range, path, from, to, %{size: size, mtime: changed}}) do
    headers =
      headers("application/vnd.pmtiles", %{
        "content-range" => "bytes #{from}-#{to}/#{size}",
        "etag" => ~s("#{size}-#{changed}")
      })

    :cowboy_req.reply(206, headers, {:sendfile, from, to - from + 1, path}, request)
  end

  defp answer(request, 416),
    do: text(request, 416, "ask for one range of at most #{@longest} bytes that the file has")

  defp answer(request, status), do: text(request, status, "no tile")

  defp text(request, status, text),
    do: :cowboy_req.reply(status, %{"content-type" => "text/plain"}, text <> "\n", request)

  defp headers(type, more) do
    Map.merge(more, %{
      "content-type" => type,
      "cache-control" => "private, max-age=86400",
      "x-content-type-options" => "nosniff",
      "cross-origin-resource-policy" => "same-origin"
    })
  end
end
