defmodule Aerie.Console.Map.Tiles.Handler do
  @moduledoc """
  Serves `Aerie.Console.Map.Tiles` to signed-in users:

    * `/tiles`: the layers, and what an admin has to decide, as JSON; a POST is an admin's answer
    * `/tiles/LAYER/Z/X/Y`: a tile, of layers that are declared and places that they can have, so nothing else
      can be fetched through the gateway
    * `/tiles/LAYER/area`: for admins, an area that is fetched beforehand: a POST says what it takes, or begins; GET,
      DELETE
    * `/tiles/LAYER`: a range of a PMTiles file (RFC 9110, section 14); a PUT by an admin uploads such a file under this
      name, a DELETE removes an uploaded one
  """

  @behaviour :cowboy_handler

  alias Aerie.Access.HTTP.{Admission, Error, Request}
  alias Aerie.Access.{Changes, Session}
  alias Aerie.Access.Changes.Rights
  alias Aerie.Console.Map.Tiles
  alias Aerie.Console.Map.Tiles.{Area, Upload}
  alias Aerie.Control.Policy.Roles
  alias Phoenix.LiveView.Cookie

  # More than any directory or tile has.
  @longest 16 * 1_048_576
  @max_answer 1_000

  @impl :cowboy_handler
  def init(request, %{gateway: gateway, policy: policy, server: server} = state) do
    facts = Request.facts(request)

    request =
      with :ok <- Admission.host(policy, facts),
           :ok <- Admission.origin(policy, facts),
           %{} = user <- Session.user(gateway, Cookie.read(request, server.secret, server.cookie)) do
        serve(state.what, :cowboy_req.method(request), gateway, user, request)
      else
        nil -> text(request, 401, "sign in first")
        {:error, error} -> text(request, error.status, error.message)
      end

    {:ok, request, state}
  end

  defp serve(:layers, "GET", gateway, user, request) do
    json(request, Map.put(Tiles.description(gateway), :may, may?(user)))
  end

  defp serve(:layers, "POST", gateway, user, request) do
    with {:may, true} <- {:may, may?(user)},
         {:ok, bytes, request} <- Request.json(request, @max_answer),
         {:ok, %{"openstreetmap" => yes?}} when is_boolean(yes?) <- Request.decode(bytes),
         :ok <- Tiles.openstreetmap(gateway, yes?, by(user, request)) do
      text(request, 200, "kept")
    else
      {:may, false} -> text(request, 403, "an admin chooses what the map stands on")
      {:error, %Error{} = error, request} -> text(request, error.status, error.message)
      {:error, words} when is_binary(words) -> text(request, 409, words)
      _other -> text(request, 400, ~s(expected {"openstreetmap": true or false}))
    end
  end

  defp serve(:area, method, gateway, user, request) do
    if may?(user),
      do: area(method, gateway, user, request),
      else: text(request, 403, "an admin prepares areas of the map")
  end

  defp serve(:tile, method, gateway, _user, request) when method in ["GET", "HEAD"] do
    [id, z, x, y] = for name <- [:layer, :z, :x, :y], do: :cowboy_req.binding(name, request)
    place = {number(z), number(x), number(y)}

    case place |> Tuple.to_list() |> Enum.all?() && Tiles.tile(gateway, id, place) do
      {:ok, tile} -> tile(request, tile)
      {:error, words} -> text(request, 502, words)
      _none -> text(request, 404, "no tile")
    end
  end

  defp serve(:archive, method, gateway, _user, request) when method in ["GET", "HEAD"],
    do: gateway |> Tiles.archive(:cowboy_req.binding(:layer, request)) |> range(request)

  # Pages of other sites cannot send this type without asking first, and the Origin was compared.
  defp serve(:archive, "PUT", gateway, user, request) do
    with true <- may?(user),
         "application/vnd.pmtiles" <- Request.header(request, "content-type"),
         {dir, most} <- Tiles.files(gateway) do
      name = :cowboy_req.binding(:layer, request)

      case Upload.store(gateway, dir, name, most, Request.patient(request, 30_000)) do
        {:ok, request} -> changed(Tiles.uploaded(gateway, name, by(user, request)), request)
        # The rest of the body is not read.
        {:error, status, words, request} -> text(closing(request), status, words)
      end
    else
      false -> text(closing(request), 403, "an admin chooses what the map stands on")
      nil -> text(closing(request), 503, "the map cannot be changed just now; try again")
      _type -> text(closing(request), 415, "the body must be application/vnd.pmtiles")
    end
  end

  defp serve(:archive, "DELETE", gateway, user, request) do
    if may?(user),
      do: changed(Tiles.remove(gateway, :cowboy_req.binding(:layer, request), by(user, request)), request),
      else: text(request, 403, "an admin chooses what the map stands on")
  end

  defp serve(_what, _method, _gateway, _user, request), do: text(request, 405, "method not allowed")

  defp area("GET", gateway, _user, request), do: json(request, Area.status(gateway))
  defp area("DELETE", gateway, _user, request), do: changed(Area.cancel(gateway), request)

  defp area("POST", gateway, user, request) do
    id = :cowboy_req.binding(:layer, request)

    with {:ok, bytes, request} <- Request.json(request, @max_answer),
         {:ok, %{"box" => [west, south, east, north] = box, "zoom" => zoom, "begin" => begin?}} <-
           Request.decode(bytes),
         true <- Enum.all?(box, &is_number/1) and is_integer(zoom) and zoom in 0..24 and is_boolean(begin?) do
      with {:ok, layer, plan, bytes} <-
             Tiles.area(gateway, id, %{west: west, south: south, east: east, north: north}, zoom),
           :ok <- if(begin?, do: Tiles.prepare(gateway, layer, plan, by(user, request)), else: :ok) do
        json(request, %{tiles: plan.total, bytes: bytes})
      else
        {:error, words} -> text(request, 409, words)
      end
    else
      {:error, %Error{} = error, request} ->
        text(request, error.status, error.message)

      _other ->
        text(
          request,
          400,
          ~s(expected {"box": [west, south, east, north], "zoom": 0 to 24, "begin": true or false})
        )
    end
  end

  defp area(_method, _gateway, _user, request), do: text(request, 405, "method not allowed")

  defp changed(:ok, request), do: text(request, 200, "kept")
  defp changed({:error, words}, request), do: text(request, 409, words)

  defp closing(request), do: :cowboy_req.set_resp_header("connection", "close", request)

  defp may?(user), do: Roles.at_least?(user.role, Rights.least(:change_map))

  defp by(user, request) do
    {peer, _port} = :cowboy_req.peer(request)
    Changes.user(%{user: user, peer: peer})
  end

  defp number(text) when byte_size(text) <= 9 do
    case Integer.parse(text) do
      {number, ""} when number >= 0 -> number
      _other -> nil
    end
  end

  defp number(_long), do: nil

  defp tile(request, %{body: body, type: type, gzip?: gzip?}) do
    more = if gzip?, do: %{"content-encoding" => "gzip"}, else: %{}
    :cowboy_req.reply(200, Map.merge(headers(type), more), body, request)
  end

  defp range(nil, request), do: text(request, 404, "no map file")

  defp range(path, request) do
    with {:ok, %File.Stat{size: size, mtime: changed}} <- File.stat(path, time: :posix),
         {:bytes, [{from, to}]} when is_integer(from) and is_integer(to) <- asked(request),
         to = min(to, size - 1),
         true <- from <= to and to - from < @longest do
      more = %{"content-range" => "bytes #{from}-#{to}/#{size}", "etag" => ~s("#{size}-#{changed}")}
      headers = Map.merge(headers("application/vnd.pmtiles"), more)
      :cowboy_req.reply(206, headers, {:sendfile, from, to - from + 1, path}, request)
    else
      {:error, _posix} -> text(request, 404, "no map file")
      _not_one_range -> text(request, 416, "ask for one range of at most #{@longest} bytes that the file has")
    end
  end

  defp asked(request) do
    :cowboy_req.parse_header("range", request)
  catch
    _kind, _malformed -> nil
  end

  defp text(request, status, text),
    do: :cowboy_req.reply(status, %{"content-type" => "text/plain; charset=utf-8"}, text <> "\n", request)

  defp json(request, value) do
    headers = Map.put(headers("application/json"), "cache-control", "no-store")
    :cowboy_req.reply(200, headers, JSON.encode!(value), request)
  end

  defp headers(type) do
    %{
      "content-type" => type,
      "cache-control" => "private, max-age=86400",
      "x-content-type-options" => "nosniff",
      "cross-origin-resource-policy" => "same-origin"
    }
  end
end
