defmodule Aerie.Api.Rest.Operations do
  @moduledoc """
  Operations (`Aerie.Control.Operations.Operation`) over REST, in the name of a key: their rows of the table of
  routes, the schemas of their bodies and answers, and what answers them. `docs/transfers.md` describes them.

  A field stands in the path, in the body, or in the query. A read takes up to `?timeout=` (seconds), and ends when
  the client hangs up. A change is waited for like a command, and then continues by itself.
  """

  alias Aerie.Base.Json
  alias Aerie.Base.Settings.Field
  alias Aerie.Control.Operations.Operation
  alias Aerie.Fleet
  alias Aerie.Vehicle.Command

  alias Aerie.Access.Changes.Rights
  alias Aerie.Api.Rest.Route
  alias Aerie.Api.Rest.Operations.{Format, LogDownload}
  alias Aerie.Api.Rest.Operations.Gateway
  alias Aerie.Access.HTTP.{Error, Request}
  alias Aerie.Access.WorkLimit

  # A transfer ends by itself.
  @longest_ms 86_400_000

  @typedoc "An operation's module, and which of its routes is meant. A compiled table cannot have its functions."
  @type choice :: {module(), route :: non_neg_integer()}

  @doc "A row for each method of each path. The first of several operations is meant unless the query selects another."
  @spec routes() :: [Route.t()]
  def routes do
    rows =
      for operation <- all(),
          {route, index} <- Enum.with_index(operation.routes),
          do: {operation, route, index}

    keys = rows |> Enum.map(&key/1) |> Enum.uniq()
    for key <- keys, do: row(Enum.filter(rows, &(key(&1) == key)))
  end

  defp key({_operation, route, _index}), do: {route.path, route.method}

  defp row([{operation, route, _index} | others] = choices) do
    %Route{
      method: route.method,
      path: route.path,
      action: {:operation, for({one, _route, index} <- choices, do: {one.module, index})},
      change: route.change,
      role: role(operation, route),
      summary: route.summary,
      query:
        formats(route) ++
          Enum.map(query(operation, route), &parameter/1) ++
          undeclared(operation, route) ++ Enum.map(others, &selected/1),
      body: if(Operation.body?(route), do: described_body(operation, route)),
      status: route.status,
      later: result?(operation),
      answer:
        cond do
          result?(operation) -> :result
          route.status == 204 -> nil
          Operation.body?(route) -> names(operation)
          true -> choices |> Enum.flat_map(&answers/1) |> with_media(route)
        end
    }
  end

  @doc "All operations."
  @spec all() :: [Operation.t()]
  def all, do: Fleet.operations() ++ Gateway.all()

  defp role(_operation, %{change: change}) when change != nil, do: Rights.least(change)
  defp role(operation, _route), do: if(operation.changes?, do: :operator, else: :viewer)

  # What is changed aboard is carried out like a command.
  defp result?(%{answer: :result}), do: true
  defp result?(operation), do: operation.transfer? and operation.changes?

  # A body that is a field as a whole.
  defp described_body(operation, route) do
    if bytes?(route),
      do: {:bytes, route.media, Enum.find(operation.fields, &(&1.key == route.file)).schema},
      else: with_media(operation.name, route)
  end

  defp with_media(name, %{media: []}), do: name
  defp with_media([], %{media: media}), do: {:bytes, media, nil}
  defp with_media(name, %{media: media}), do: {:bytes, ["application/json" | media], name}

  # What has no form as JSON is bytes.
  defp answers({operation, route, _index}),
    do: if(bytes?(route), do: [], else: names(operation))

  defp names(%{answer: [name | _] = names}) when is_atom(name), do: names
  defp names(operation), do: [Operation.answer_name(operation)]

  defp bytes?(route), do: route.media != [] and route.formats == []

  defp formats(%{formats: []}), do: []
  defp formats(%{formats: formats}), do: [{:format, formats}]

  defp parameter(field),
    do: {field.key, %{field | required: true} |> Field.schema() |> Map.delete(:description), sentence(field)}

  defp selected({_operation, route, _index}), do: {route.select, %{type: :string}, route.summary}

  defp sentence(%{doc: doc, unit: unit}) do
    {first, rest} = String.split_at(doc, 1)
    String.upcase(first) <> rest <> if(unit, do: " (#{unit}).", else: ".")
  end

  # What stands in the query: without a body everything that is not in the path.
  defp query(operation, %{stream?: true}), do: common(operation)

  defp query(operation, route) do
    own =
      if Operation.body?(route),
        do: Enum.filter(operation.fields, &(&1.key in route.query)),
        else: operation.fields

    own =
      for field <- own,
          field.schema != false,
          field.key not in route.omit,
          not in_path?(field, route),
          do: field

    own ++ common(operation)
  end

  # `Aerie.Api.Rest.OpenAPI.Parameters` describes those of a request that its reader checks.
  defp undeclared(operation, route), do: route.query -- Enum.map(operation.fields, & &1.key)

  # Nobody sees the progress of a read.
  defp common(%{changes?: true} = operation), do: Operation.common(operation) ++ more(operation)
  defp common(operation), do: Enum.reject(Operation.common(operation), &(&1.key == :id))

  defp in_path?(field, route) do
    name = Field.name(field)
    is_map_key(route.given, name) or name in named(route) or (name == "path" and route.path =~ "[...]")
  end

  @doc "The fields that the path of a route names. The id of a vehicle is not a field."
  @spec named(%{:path => String.t(), optional(atom()) => term()}) :: [String.t()]
  def named(%{path: path}) do
    path = String.replace_prefix(path, "/api/vehicles/:id", "")
    for [":" <> name] <- Regex.scan(~r{:[a-z]+}, path), do: name
  end

  @doc "The schemas of bodies and answers, by the names that the rows have."
  @spec schemas() :: %{String.t() => Json.Schema.t()}
  def schemas do
    for operation <- all(), route <- operation.routes, reduce: %{} do
      schemas ->
        schemas
        |> Map.merge(if(described?(route), do: body_schema(operation, route), else: %{}))
        |> Map.merge(answer_schema(operation, route))
    end
  end

  defp body_schema(operation, route) do
    common = for field <- common(operation), into: %{}, do: {field.key, Field.schema(field)}
    elsewhere = for field <- operation.fields, in_path?(field, route), do: field.key

    fields =
      for field <- operation.fields, do: %{field | required: field.required or field.key in route.required}

    # A rule may be about a field in the query.
    rules = if route.query == [], do: operation.rules, else: []

    %{
      operation.name =>
        Operation.schema(%{operation | fields: fields, rules: rules}, common, [], elsewhere ++ route.omit)
    }
  end

  defp described?(route), do: Operation.body?(route) and not bytes?(route)

  defp answer_schema(%{answer: [name | _]}, _route) when is_atom(name), do: %{}

  defp answer_schema(operation, route) do
    if result?(operation) or (bytes?(route) and not Operation.body?(route)) or route.status == 204,
      do: %{},
      else: %{Operation.answer_name(operation) => Operation.answer_schema(operation)}
  end

  # --- Requests

  @doc "Answers a request for one of the operations of a row."
  @spec run([choice(), ...], map(), :cowboy_req.req()) ::
          {:ok, 200..299, map() | {:text, String.t(), iodata(), String.t()} | :sent | nil, :cowboy_req.req()}
          | {:error, Error.t(), :cowboy_req.req()}
  def run(choices, state, request) do
    parameters = Request.parameters(request)
    {operation, route} = choose(choices, parameters)
    request = if operation.transfer?, do: Request.patient(request, @longest_ms), else: request

    with {:ok, format} <- format(route, parameters, request),
         {:ok, body, request} <- body(operation, route, request),
         {:ok, input} <- input(operation, route, format, body, state, request) do
      request = if input[:timeout], do: Request.patient(request, ceil(input.timeout * 1000)), else: request
      signed = %{header: Request.header(request, "aerie-signature"), body: body}
      context = state |> context(route, format, input, request) |> Map.put(:signed, signed)
      act(operation, route, input, context, request)
    else
      {:error, %Error{} = error, request} -> {:error, error, request}
      {:error, error} -> {:error, Error.from(error), request}
    end
  end

  defp choose(choices, parameters) do
    [first | others] =
      for {module, index} <- choices,
          one = %{module.operation() | module: module},
          do: {one, Enum.at(one.routes, index)}

    Enum.find(others, first, fn {_operation, route} -> is_map_key(parameters, route.select) end)
  end

  defp format(%{formats: []}, _parameters, _request), do: {:ok, "json"}

  defp format(route, parameters, request) do
    header = if Operation.body?(route), do: "content-type", else: "accept"
    Format.choose(parameters["format"], Request.header(request, header), route.formats)
  end

  defp body(operation, route, request) do
    cond do
      not Operation.body?(route) -> {:ok, "", request}
      # Any web page may send a form.
      not operation.transfer? and route.file == nil -> Request.json(request, route.max_bytes)
      true -> Request.bytes(request, route.max_bytes)
    end
  end

  # Files that are parsed cost more than a request.
  defp input(operation, %{method: "PUT", formats: [_ | _]} = route, format, body, state, request) do
    asker = {:name, state.source.name}

    case WorkLimit.run(state.gateway, :parse, asker, fn -> read(operation, route, format, body, request) end) do
      {:ok, result} -> result
      {:busy, seconds} -> {:error, Error.busy(seconds)}
    end
  end

  defp input(operation, route, format, body, _state, request),
    do: read(operation, route, format, body, request)

  defp read(operation, %{stream?: true} = route, _format, _body, request) do
    operation = %{operation | fields: []}
    Operation.parse(operation, texts(operation, route, request))
  end

  defp read(operation, route, format, body, request) do
    file? = route.file != nil and (format != "json" or route.formats == [])
    own = if file?, do: [file: {route.file, body}, format: format], else: [required: route.required]

    with {:ok, object} <- if(file? or not Operation.body?(route), do: {:ok, %{}}, else: Request.decode(body)) do
      object = given(operation, route, object)
      given = operation |> texts(route, request) |> Map.merge(object) |> Map.merge(route.given)
      options = [more: more(operation), omit: route.omit] ++ own
      Operation.parse(operation, Map.merge(given, path(route, request)), options)
    end
  end

  # A change of the gateway that has a schema of its own says what null means. For all others it is the same as nothing,
  # also beside a parameter of the query.
  defp given(%{request: %{}}, %{change: change}, object) when change != nil, do: object
  defp given(_operation, _route, object), do: Map.reject(object, fn {_key, value} -> value == nil end)

  defp more(operation), do: if(result?(operation), do: [Operation.wait()], else: [])

  # The parameters of the query that the operation has; others are left alone, or refused if it says so.
  defp texts(operation, route, request) do
    # A change of the gateway has its fields in the body.
    own = if route.change, do: [], else: operation.fields ++ Operation.common(operation)

    names =
      Enum.map(route.query, &Atom.to_string/1) ++
        for field <- own ++ more(operation), field.key not in route.omit, do: Field.name(field)

    for {name, text} <- Request.parameters(request),
        (operation.closed? and route.change == nil) or (text != nil and name in names),
        into: %{},
        do: {name, {:text, text || ""}}
  end

  defp path(route, request) do
    rest =
      if route.path =~ "[...]",
        do: %{"path" => "/" <> Enum.join(:cowboy_req.path_info(request), "/")},
        else: %{}

    for name <- named(route),
        into: rest,
        do: {name, :cowboy_req.bindings(request)[String.to_existing_atom(name)]}
  end

  defp context(state, route, format, input, request) do
    source = state.source

    %{
      gateway: state.gateway,
      # The id in another path is a field.
      vehicle: if("id" not in named(route), do: :cowboy_req.binding(:id, request, nil)),
      source: source,
      via: "rest",
      by: "http:" <> source.name,
      options: [as: source, via: "rest"] ++ Operation.options(input),
      format: format,
      max_bytes: nil
    }
  end

  defp act(_operation, %{stream?: true}, _input, context, request) do
    case LogDownload.run({context.gateway, context.vehicle}, context.options, request) do
      {:ok, status, :sent, request} -> {:ok, status, :sent, request}
      {:error, error} -> {:error, Error.from(error), request}
    end
  end

  defp act(operation, route, input, context, request) do
    case {operation.module.run(input, context), result?(operation)} do
      {{:ok, result}, true} -> ended(result, context, request)
      {answer, _result?} -> answered(answer, route.status, context, request)
    end
  end

  defp ended(result, context, request) do
    case Error.of_result(result) do
      nil -> {:ok, 200, Command.plain(result), located(request, context.vehicle, result.id)}
      error -> {:error, error, request}
    end
  end

  defp answered({:pending, id}, _status, %{vehicle: vehicle}, request),
    do: {:ok, 202, %{"id" => id, "vehicle" => vehicle, "state" => "under_way"}, located(request, vehicle, id)}

  defp answered({:ok, {:bytes, bytes, path}}, _status, _context, request),
    do: {:ok, 200, {:text, Format.bytes(), bytes, Path.basename(path)}, request}

  defp answered({:ok, {:file, name, text}}, _status, %{format: format}, request),
    do: {:ok, 200, {:text, Format.type(format), text, name}, request}

  defp answered(:ok, status, _context, request), do: {:ok, status, nil, request}
  defp answered({:ok, object}, status, _context, request), do: {:ok, status, object, request}
  defp answered({:error, error}, _status, _context, request), do: {:error, Error.from(error), request}

  # `GET` and `DELETE` work there as for commands.
  defp located(request, vehicle, id),
    do: :cowboy_req.set_resp_header("location", "/api/vehicles/#{vehicle}/commands/#{id}", request)
end
