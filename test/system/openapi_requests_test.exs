defmodule Aerie.System.OpenAPIRequestsTest do
  @moduledoc """
  What `docs/openapi.json` takes, REST takes: requests made from the description, the smallest ones, with every key, at the limits, and none is
  refused for its shape. There is no vehicle, so whatever is asked of one fails for that reason, after its shape was read.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Api.Rest.Operations.Log
  alias Aerie.Control.Operations.Operation
  alias Aerie.JsonSchemaSample

  @moduletag :tmp_dir
  @moduletag :capture_log
  @document JSON.decode!(File.read!(Path.expand("../../docs/openapi.json", __DIR__)))
  @item %{"type" => "SimpleItem", "command" => 16, "frame" => 3, "params" => [0, 0, 0, 0, 47.1, 8.2, 20]}
  @corners [[47.1, 8.1], [47.2, 8.1], [47.2, 8.2]]
  @plan %{
    "fileType" => "Plan",
    "version" => 1,
    "mission" => %{"version" => 2, "items" => [@item]},
    "geoFence" => %{
      "version" => 2,
      "circles" => [],
      "polygons" => [%{"version" => 1, "inclusion" => true, "polygon" => @corners}]
    },
    "rallyPoints" => %{"version" => 2, "points" => [[47.1, 8.2, 20]]}
  }
  @urls %{"post_api_links" => "udpin:127.0.0.1:0", "post_api_clients" => "tcpin:127.0.0.1:0"}
  @samples 12

  setup %{tmp_dir: folder} do
    file = private_file(folder, "keys", for(n <- 1..100, do: "key-#{n} #{key(n)} role=admin\n"))
    start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: %{"api" => %{"keys_file" => file}})
  end

  defp key(n), do: "a-key-for-the-requests-#{n}"

  test "no request that the description takes is refused for its shape", %{gateway: gateway} do
    base = "http://127.0.0.1:#{Aerie.Api.Endpoint.port(gateway)}"

    operations =
      for {path, methods} <- @document["paths"], {method, operation} <- methods, do: {path, method, operation}

    assert length(operations) > 60

    for {{path, method, _operation} = what, index} <- Enum.with_index(Enum.sort(operations), 1) do
      refused = for n <- 1..@samples, do: refusal(base, what, n, key(index))
      assert Enum.reject(refused, &(&1 in [nil, :busy])) == []
      assert nil in refused, "#{method} #{path} was never read"
    end
  end

  defp refusal(base, {path, method, operation}, n, key) do
    :rand.seed(:exsss, ExUnit.configuration()[:seed] + n)
    how = Enum.at([:least, :most], n - 1, :some)
    {places, query} = parameters(operation, how)
    places = if path == "/api/rules/{id}", do: %{"id" => "link-1"}, else: places
    url = base <> filled(path, places) <> if(query == %{}, do: "", else: "?" <> URI.encode_query(query))
    body = body(operation, query, how)

    # The log is everybody's.
    if {method, path} == {"patch", "/api/log"},
      do:
        with({:ok, _input} <- Operation.parse(%{Log.Change.operation() | module: Log.Change}, body), do: nil),
      else: asked(String.to_existing_atom(method), url, body, key)
  end

  defp parameters(operation, how) do
    chosen =
      for one <- operation["parameters"],
          one["required"] or how == :most or (how == :some and :rand.uniform(2) == 1),
          do: one

    {places, query} = Enum.split_with(chosen, &(&1["in"] == "path"))

    value = fn one ->
      {one["name"], one["schema"] |> JsonSchemaSample.value(@document, how) |> to_string()}
    end

    {Map.new(places, value), query |> Map.new(value) |> consistent(operation)}
  end

  # What the texts of the parameters say.
  defp consistent(%{"format" => format} = query, %{"requestBody" => _body}) when format != "json",
    do: Map.delete(query, "format")

  defp consistent(%{"format" => format} = query, _operation) when format != "json",
    do: Map.delete(query, "component")

  defp consistent(query, _operation), do: query

  defp filled(path, places) do
    Regex.replace(~r/\{(\w+)\}/, path, fn _all, name ->
      # A segment of dots is not one of its own: HTTP takes it out of the path.
      if places[name] in [".", ".."], do: "dots", else: URI.encode(places[name], &URI.char_unreserved?/1)
    end)
  end

  defp body(
         %{"requestBody" => %{"content" => %{"application/json" => %{"schema" => schema}}}} = operation,
         query,
         how
       ) do
    schema |> JsonSchemaSample.value(@document, how) |> suitable(operation["operationId"], query)
  end

  defp body(%{"requestBody" => _bytes}, _query, _how), do: :bytes
  defp body(_operation, _query, _how), do: nil

  defp suitable(%{"url" => _url} = body, id, _query), do: %{body | "url" => Map.fetch!(@urls, id)}
  defp suitable(%{"fileType" => _plan}, _id, _query), do: @plan
  defp suitable(%{"plan" => _plan} = body, _id, _query), do: %{body | "plan" => @plan}

  defp suitable(%{"value" => text} = body, _id, query)
       when is_binary(text) and not is_map_key(query, "component"),
       do: %{body | "value" => 1}

  defp suitable(body, _id, _query) do
    for {key, value} <- body, into: %{} do
      {key, if(key in ["issued_at", "deadline"] and value != nil, do: System.os_time(:second), else: value)}
    end
  end

  # `:busy`, nil, or a text that says what was refused. Each operation has a key of its own, and with it rates of its own.
  defp asked(method, url, body, key) do
    headers = [{~c"x-aerie-key", String.to_charlist(key)}, {~c"connection", ~c"close"}]

    request =
      case body do
        nil when method in [:post, :put, :patch] -> {url, headers, ~c"application/json", "{}"}
        nil -> {url, headers}
        :bytes -> {url, headers, ~c"application/octet-stream", "bytes"}
        object -> {url, headers, ~c"application/json", JSON.encode!(object)}
      end

    {:ok, {{_version, status, _reason}, _headers, reply}} = http(method, request, timeout: :infinity)

    cond do
      status == 429 ->
        :busy

      shape?(status, reply) ->
        nil

      true ->
        "#{method} #{url} #{inspect(body, limit: :infinity, printable_limit: :infinity)}\n#{status} #{reply}"
    end
  end

  # A refusal that comes with a result is for what the vehicle or the policy is, and not for the request's shape.
  defp shape?(status, _reply) when status in [400, 405, 413, 414, 415, 500], do: false

  defp shape?(422, reply) do
    answer = JSON.decode!(reply)

    (is_binary(answer["result"]) and answer["rule"] != "malformed") or
      answer["error"]["message"] =~ ~r/one that a vehicle has|^unknown network|^carry: unknown link/ or
      futile?(answer["errors"])
  end

  defp shape?(_status, _reply), do: true

  # Waits that cannot come true by the steps before them or by each other, which no schema can say.
  defp futile?([_ | _] = errors),
    do:
      Enum.all?(
        errors,
        &(&1["expected"] =~
            ~r/ by then, | is not surely higher |^more than the .* goes$|^a vehicle that lands without/)
      )

  defp futile?(_none), do: false
end
