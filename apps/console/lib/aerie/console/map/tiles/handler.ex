defmodule Aerie.Console.Map.Tiles.Handler do
  @moduledoc "Serves `Aerie.Console.Map.Tiles` to signed-in users. A path consists of three numbers, so it can only lead to a tile."

  @behaviour :cowboy_handler

  alias Aerie.Access.HTTP.{Admission, Request}
  alias Aerie.Access.Session
  alias Aerie.Console.Map.Tiles
  alias Phoenix.LiveView.Cookie

  @impl :cowboy_handler
  def init(request, %{gateway: gateway, policy: policy, server: server} = state) do
    session = Cookie.read(request, server.secret, server.cookie)

    status =
      with :ok <- Admission.host(policy, Request.facts(request)),
           %{} <- Session.user(gateway, session) do
        tile(gateway, Enum.map([:z, :x, :y], &number(:cowboy_req.binding(&1, request))))
      else
        nil -> 401
        {:error, error} -> error.status
      end

    {:ok, answer(request, status), state}
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

  defp answer(request, {bytes, type, gzip?}) do
    headers = %{
      "content-type" => type,
      "cache-control" => "private, max-age=86400",
      "x-content-type-options" => "nosniff",
      "cross-origin-resource-policy" => "same-origin"
    }

    headers = if gzip?, do: Map.put(headers, "content-encoding", "gzip"), else: headers
    :cowboy_req.reply(200, headers, bytes, request)
  end

  defp answer(request, status),
    do: :cowboy_req.reply(status, %{"content-type" => "text/plain"}, "no tile\n", request)
end
