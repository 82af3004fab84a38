defmodule FleetWeb.API.Transfers do
  @moduledoc """
  Parameters, plans, files and logs of a vehicle over REST: `Aerie.Control.Params`, `Aerie.Control.Missions`, `Aerie.Control.Files` and `Aerie.Control.Logs` in the name of a key.
  `docs/transfers.md` describes it.

  A read takes up to `?timeout=` (seconds), and ends when the client hangs up. A change is waited for
  like a command, and then continues by itself.
  """

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.{Files, Logs, Missions, Params}
  alias Aerie.Control.Params.{Param, Table}
  alias FleetWeb.API.{Commands, Error, Format, LogDownload, Request}
  alias FleetWeb.WorkLimit

  @max_timeout_s Aerie.Control.Transfers.max_timeout_s()
  # A transfer ends by itself.
  @longest_ms 86_400_000
  @plan_bytes 4_194_304
  @param_bytes 1_048_576
  @file_bytes Aerie.Control.Ftp.Client.max_bytes()
  @object_bytes 16_384

  @type action ::
          :list_params
          | :load_params
          | :get_param
          | :param_metadata
          | :set_param
          | {:get_plan | :put_plan | :clear_plan, Missions.kind()}
          | :read_file
          | :write_file
          | :remove_file
          | :list_logs
          | :download_log
  @type result ::
          {:ok, 200 | 202 | 206, map() | {:text, String.t(), iodata(), String.t()} | :sent, :cowboy_req.req()}
          | {:error, Error.t(), :cowboy_req.req()}

  @doc "Runs an action. `state` has the gateway and the requester."
  @spec run(action(), map(), :cowboy_req.req()) :: result()
  def run(action, %{gateway: gateway, requester: requester}, request) do
    parameters = Request.parameters(request)

    with {:ok, timeout_ms} <- timeout_ms(parameters["timeout"]),
         {:ok, wait_ms} <- Commands.wait_ms(parameters["wait"]) do
      request = Request.patient(request, timeout_ms || @longest_ms)
      more = if timeout_ms, do: [timeout_ms: timeout_ms], else: []
      options = [as: Commands.source(requester), via: "rest", wait_ms: wait_ms] ++ more
      act(action, {gateway, :cowboy_req.binding(:id, request)}, options, parameters, request)
    else
      {:error, error} -> {:error, error, request}
    end
  end

  # --- Parameters

  defp act(:list_params, {gateway, vehicle}, options, parameters, request) do
    with {:ok, format} <- wanted(parameters, request, ["json", "param", "params", "txt"]),
         {:ok, options} <- component(parameters, options, format == "json"),
         {:ok, body} <- list_params(format, gateway, vehicle, options) do
      {:ok, 200, body, request}
    else
      error -> refused(error, request)
    end
  end

  defp act(:load_params, {gateway, vehicle}, options, parameters, request) do
    with {:ok, format} <- given(parameters, request, ["json", "param", "params", "txt"]),
         {:ok, options} <- component(parameters, options, false),
         {:ok, text, request} <- Request.bytes(request, @param_bytes) do
      unknown = if parameters["unknown"] == "skip", do: :skip, else: :refuse

      case format do
        "json" ->
          with {:ok, object} <- parsed(gateway, options, fn -> Request.decode(text) end),
               :ok <- Request.known(object, ["id", "values"]),
               {:ok, values} <- values(object) do
            Params.set_all(gateway, vehicle, values, with_id(options, object, parameters))
          end

        _file ->
          options = [unknown: unknown] ++ with_id(options, %{}, parameters)

          # The file is read where it is loaded; here is seen that not too many are.
          with {:ok, _entries} <- parsed(gateway, options, fn -> Params.parse(text) end),
               do: Params.load(gateway, vehicle, text, options)
      end
      |> changed(vehicle, request)
    else
      {:error, error, request} -> {:error, error, request}
      error -> refused(error, request)
    end
  end

  defp act(:get_param, {gateway, vehicle}, options, parameters, request) do
    with {:ok, options} <- component(parameters, options),
         {:ok, param} <- Params.get(gateway, vehicle, :cowboy_req.binding(:name, request), options) do
      {:ok, 200, Param.plain(param), request}
    else
      error -> refused(error, request)
    end
  end

  defp act(:param_metadata, {gateway, vehicle}, options, _parameters, request) do
    case Params.metadata(gateway, vehicle, options) do
      {:ok, all} -> {:ok, 200, %{params: all |> Map.values() |> Enum.sort_by(& &1.name)}, request}
      error -> refused(error, request)
    end
  end

  defp act(:set_param, {gateway, vehicle}, options, parameters, request) do
    name = :cowboy_req.binding(:name, request)

    with {:ok, text, request} <- Request.bytes(request, @object_bytes) do
      with {:ok, object} <- Request.decode(text),
           :ok <- Request.known(object, ["id", "value"]),
           {:ok, options} <- component(parameters, options) do
        Params.set(gateway, vehicle, name, object["value"], with_id(options, object, parameters))
      end
      |> changed(vehicle, request)
    end
  end

  # --- Plans

  defp act({:get_plan, kind}, {gateway, vehicle}, options, parameters, request) do
    with {:ok, format} <- wanted(parameters, request, formats(kind)),
         {:ok, stored} <- Missions.download(gateway, vehicle, kind, options),
         {:ok, body} <- plan_body(format, stored, kind, vehicle) do
      {:ok, 200, body, request}
    else
      error -> refused(error, request)
    end
  end

  defp act({:put_plan, kind}, {gateway, vehicle}, options, parameters, request) do
    with {:ok, format} <- given(parameters, request, formats(kind)),
         {:ok, text, request} <- Request.bytes(request, @plan_bytes) do
      with {:ok, plan, object} <- parsed(gateway, options, fn -> plan(format, text) end),
           {:ok, force} <- force(object["force"] || parameters["force"]) do
        options = [force: force] ++ with_id(options, object, parameters)
        Missions.upload(gateway, vehicle, kind, plan, options)
      end
      |> changed(vehicle, request)
    else
      {:error, error, request} -> {:error, error, request}
      error -> refused(error, request)
    end
  end

  defp act({:clear_plan, kind}, {gateway, vehicle}, options, parameters, request) do
    gateway
    |> Missions.clear(vehicle, kind, with_id(options, %{}, parameters))
    |> changed(vehicle, request)
  end

  # --- Files and logs

  defp act(:read_file, {gateway, vehicle}, options, parameters, request) do
    path = path(request)

    cond do
      is_map_key(parameters, "crc") ->
        with {:ok, crc} <- Files.crc(gateway, vehicle, path, options), do: {:ok, %{path: path, crc32: crc}}

      is_map_key(parameters, "list") ->
        with {:ok, entries} <- Files.list(gateway, vehicle, path, options),
             do: {:ok, %{path: path, entries: entries}}

      true ->
        with {:ok, bytes} <- Files.read(gateway, vehicle, path, options),
             do: {:ok, {:text, Format.bytes(), bytes, Path.basename(path)}}
    end
    |> case do
      {:ok, body} -> {:ok, 200, body, request}
      error -> refused(error, request)
    end
  end

  defp act(:write_file, {gateway, vehicle}, options, parameters, request) do
    with {:ok, bytes, request} <- Request.bytes(request, @file_bytes) do
      gateway
      |> Files.write(vehicle, path(request), bytes, with_id(options, %{}, parameters))
      |> changed(vehicle, request)
    end
  end

  defp act(:remove_file, {gateway, vehicle}, options, parameters, request) do
    gateway
    |> Files.remove(vehicle, path(request), with_id(options, %{}, parameters))
    |> changed(vehicle, request)
  end

  defp act(:list_logs, {gateway, vehicle}, options, _parameters, request) do
    case Logs.list(gateway, vehicle, options) do
      {:ok, logs} -> {:ok, 200, %{logs: logs}, request}
      error -> refused(error, request)
    end
  end

  defp act(:download_log, place, options, _parameters, request) do
    case LogDownload.run(place, options, request) do
      {:ok, status, :sent, request} -> {:ok, status, :sent, request}
      error -> refused(error, request)
    end
  end

  # --- Formats

  defp list_params("json", gateway, vehicle, options) do
    with {:ok, table} <- Params.list(gateway, vehicle, options), do: {:ok, Table.plain(table)}
  end

  defp list_params(format, gateway, vehicle, options) do
    with {:ok, text} <-
           Params.save(
             gateway,
             vehicle,
             %{"param" => :param, "params" => :params, "txt" => :txt}[format],
             options
           ),
         do: {:ok, file(format, text, "#{vehicle}.#{format}")}
  end

  defp file(format, text, name), do: {:text, Format.type(format), text, name}

  defp plan_body("json", stored, kind, _vehicle), do: {:ok, Missions.plain(stored, kind)}

  defp plan_body(format, stored, kind, vehicle) do
    case Missions.export(stored.plan, plan_format(format)) do
      {:ok, text} -> {:ok, file(format, text, "#{vehicle}-#{kind}.#{format}")}
      {:error, reason} -> Error.invalid(reason)
    end
  end

  @doc "The forms that a plan of a kind may have."
  @spec formats(Missions.kind()) :: [String.t(), ...]
  def formats(:mission), do: ["json", "waypoints", "plan", "mission"]
  def formats(_other), do: ["json", "plan"]

  defp plan_format("plan"), do: :plan
  defp plan_format("waypoints"), do: :waypoints
  defp plan_format("mission"), do: :mission

  # In JSON the plan is beside the id.
  defp plan("json", text) do
    with {:ok, object} <- Request.decode(text),
         :ok <- Request.known(object, ["id", "plan", "force"]),
         {:ok, plan, _none} <- plan("plan", JSON.encode!(object["plan"])),
         do: {:ok, plan, object}
  end

  defp plan(format, text) do
    case Missions.import(text, plan_format(format)) do
      {:ok, plan} -> {:ok, plan, %{}}
      {:error, reason} -> Error.invalid(reason)
    end
  end

  defp force(nil), do: {:ok, false}
  defp force(value) when value in [true, "true"], do: {:ok, true}
  defp force(value) when value in [false, "false"], do: {:ok, false}
  defp force(_other), do: Error.invalid("force: expected true or false")

  # Uploads are parsed within the limit of `FleetWeb.WorkLimit`.
  defp parsed(gateway, options, parse) do
    case WorkLimit.run(gateway, :parse, {:name, options[:as].name}, parse) do
      {:ok, result} -> result
      {:busy, seconds} -> {:error, Error.busy(seconds)}
    end
  end

  # Files of parameters have only numbers, as autopilots do.
  defp component(parameters, options, offered? \\ true) do
    case parameters["component"] do
      nil ->
        {:ok, options}

      _text when not offered? ->
        Error.invalid("component: only the list as JSON and single parameters have it")

      text ->
        case Integer.parse(text) do
          {id, ""} when id in 1..255 -> {:ok, [component: id] ++ options}
          _other -> Error.invalid("component: expected an integer from 1 to 255")
        end
    end
  end

  # The format that a request without a body wants, or that of the body.
  defp wanted(parameters, request, formats),
    do: Format.choose(parameters["format"], Request.header(request, "accept"), formats)

  defp given(parameters, request, formats),
    do: Format.choose(parameters["format"], Request.header(request, "content-type"), formats)

  # Empty segments do not belong to a path on board.
  defp path(request), do: "/" <> Enum.join(:cowboy_req.path_info(request), "/")

  defp with_id(options, object, parameters) do
    case object["id"] || parameters["id"] do
      nil -> options
      id -> [id: id] ++ options
    end
  end

  defp timeout_ms(nil), do: {:ok, nil}

  defp timeout_ms(text) do
    case Integer.parse(text) do
      {seconds, ""} when seconds in 1..@max_timeout_s -> {:ok, seconds * 1000}
      _other -> Error.invalid("timeout: expected 1 to #{@max_timeout_s} seconds")
    end
  end

  # --- Answers

  defp refused({:error, %Result{} = result}, request), do: {:error, Error.of_result(result), request}
  defp refused({:error, [_ | _] = errors}, request), do: {:error, Error.malformed(errors), request}
  defp refused({:error, %Error{} = error}, request), do: {:error, error, request}

  defp values(%{"values" => %{} = values}), do: {:ok, values}
  defp values(_other), do: Error.invalid("values: expected an object of names and numbers")

  defp changed({:ok, result}, vehicle, request) do
    case Error.of_result(result) do
      nil -> {:ok, 200, Result.plain(result), located(request, vehicle, result.id)}
      error -> {:error, error, request}
    end
  end

  defp changed({:pending, id}, vehicle, request),
    do: {:ok, 202, %{"id" => id, "vehicle" => vehicle, "state" => "under_way"}, located(request, vehicle, id)}

  defp changed(error, _vehicle, request), do: refused(error, request)

  # `GET` and `DELETE` work there as for commands.
  defp located(request, vehicle, id),
    do: :cowboy_req.set_resp_header("location", "/api/vehicles/#{vehicle}/commands/#{id}", request)
end
