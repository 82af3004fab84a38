defmodule FleetWeb.API.Resources do
  @moduledoc "The resources below `/api`, the methods of each, and their actions."

  alias Aerie.{Client, Enrolment, Link, Policy, Router}
  alias Aerie.Command.Types

  alias FleetWeb.API.{
    Commands,
    Error,
    EventsQuery,
    FleetOperations,
    ClientRequest,
    LinkRequest,
    LogLevels,
    OpenAPI,
    Recordings,
    Request,
    RuleChanges,
    Shadow,
    SigningRequest,
    Tickets,
    Transfers,
    View
  }

  plan = fn kind ->
    %{
      "GET" => {:transfer, {:get_plan, kind}},
      "PUT" => {:transfer, {:put_plan, kind}},
      "DELETE" => {:transfer, {:clear_plan, kind}}
    }
  end

  @resources [
    {"/api", :index, %{"GET" => :index}},
    {"/api/openapi", :openapi, %{"GET" => :openapi}},
    {"/api/status", :status, %{"GET" => :status}},
    {"/api/diagnosis", :diagnosis, %{"GET" => :diagnosis}},
    {"/api/vehicles", :vehicles, %{"GET" => :vehicles}},
    {"/api/vehicles/:id", :vehicle, %{"GET" => :vehicle}},
    {"/api/vehicles/:id/events", :vehicle_events, %{"GET" => :vehicle_events}},
    {"/api/events", :events, %{"GET" => :events}},
    {"/api/vehicles/:id/save", :save, %{"POST" => :save}},
    {"/api/vehicles/:id/recording", :vehicle_recording, %{"PUT" => :record_vehicle}},
    {"/api/vehicles/:id/signing", :vehicle_signing, %{"GET" => :vehicle_signing, "POST" => :sign_vehicle}},
    {"/api/signing", :signing, %{"GET" => :signing}},
    {"/api/links", :links, %{"GET" => :links, "POST" => :add_link}},
    {"/api/links/:id", :link, %{"DELETE" => :remove_link}},
    {"/api/links/:id/recording", :link_recording, %{"PUT" => :record_link}},
    {"/api/recorder", :recorder, %{"GET" => :recorder}},
    {"/api/recordings/:name", :recording, %{"GET" => :download}},
    {"/api/clients", :clients, %{"GET" => :clients, "POST" => :add_client}},
    {"/api/clients/:id", :client, %{"DELETE" => :remove_client}},
    {"/api/rules", :rules, %{"GET" => :rules}},
    {"/api/rules/:id", :rule, %{"PATCH" => :change_rules, "DELETE" => :reset_rules}},
    {"/api/vehicles/:id/commands", :commands, %{"POST" => :command}},
    {"/api/vehicles/:id/commands/:command", :command,
     %{"GET" => :look_at_command, "DELETE" => :cancel_command}},
    {"/api/vehicles/:id/shadow", :shadow,
     %{"GET" => :shadow, "PATCH" => :update_shadow, "DELETE" => :delete_shadow}},
    {"/api/vehicles/:id/shadow/delta", :shadow_delta, %{"GET" => :shadow_delta}},
    {"/api/config/reload", :config_reload, %{"POST" => :reload_config}},
    {"/api/log", :log, %{"GET" => :log, "PATCH" => :change_log}},
    {"/api/operations", :operations, %{"GET" => :operations, "POST" => :begin_operation}},
    {"/api/operations/:id", :operation, %{"GET" => :operation, "DELETE" => :stop_operation}},
    {"/api/policy", :policy, %{"GET" => :policy}},
    {"/api/policy/reload", :policy_reload, %{"POST" => :reload_policy}},
    {"/api/plans", :plans, %{"POST" => :store_plan}},
    {"/api/commands/types", :command_types, %{"GET" => :command_types}},
    {"/api/vehicles/:id/params", :params,
     %{"GET" => {:transfer, :list_params}, "PUT" => {:transfer, :load_params}}},
    {"/api/vehicles/:id/params/:name", :param,
     %{"GET" => {:transfer, :get_param}, "PUT" => {:transfer, :set_param}}},
    {"/api/vehicles/:id/metadata/params", :param_metadata, %{"GET" => {:transfer, :param_metadata}}},
    {"/api/vehicles/:id/mission", :mission, plan.(:mission)},
    {"/api/vehicles/:id/fence", :fence, plan.(:fence)},
    {"/api/vehicles/:id/rally", :rally, plan.(:rally)},
    {"/api/vehicles/:id/files/[...]", :files,
     %{
       "GET" => {:transfer, :read_file},
       "PUT" => {:transfer, :write_file},
       "DELETE" => {:transfer, :remove_file}
     }},
    {"/api/vehicles/:id/logs", :logs, %{"GET" => {:transfer, :list_logs}}},
    {"/api/vehicles/:id/logs/:log", :vehicle_log, %{"GET" => {:transfer, :download_log}}},
    {"/api/tickets", :tickets, %{"POST" => :issue_ticket}},
    {"/api/[...]", :missing, %{}}
  ]
  # What an operator may not do.
  @admins [:reload_policy, :reload_config, :change_log, :add_link, :remove_link]
  @signing_results %{enrol: "enrolled", revoke: "revoked", discard: "discarded"}
  @methods Map.new(@resources, fn {_path, resource, methods} -> {resource, methods} end)

  @typedoc "A body is an object, a file as `{:file, path, bytes}`, text or bytes as `{:text, content_type, text, name}`, nothing, or `:sent` already."
  @type result ::
          {:ok, 200..299,
           map()
           | {:file, Path.t(), non_neg_integer()}
           | {:text, String.t(), iodata(), String.t()}
           | :sent
           | nil, :cowboy_req.req()}
          | {:error, Error.t(), :cowboy_req.req()}

  @doc "The paths for Cowboy, each with the name of its resource."
  @spec paths() :: [{String.t(), atom()}]
  def paths, do: for({path, resource, _methods} <- @resources, do: {path, resource})

  @doc "Each path with its methods and what they do."
  @spec actions() :: [{path :: String.t(), method :: String.t(), action :: atom() | tuple()}]
  def actions,
    do: for({path, _resource, methods} <- @resources, {method, action} <- methods, do: {path, method, action})

  @doc "The methods of a resource; with GET also HEAD."
  @spec methods(atom()) :: [String.t()]
  def methods(resource) do
    methods = Map.keys(Map.fetch!(@methods, resource))
    if "GET" in methods, do: methods ++ ["HEAD"], else: methods
  end

  @doc "The action of a method on a resource. HEAD is GET; Cowboy leaves out the body."
  @spec action(atom(), String.t()) :: {:ok, atom() | tuple()} | {:error, Error.t()}
  def action(:missing, _method), do: {:error, Error.new(:not_found, "there is no such resource; see /api")}
  def action(resource, "HEAD"), do: action(resource, "GET")

  def action(resource, method) do
    methods = Map.fetch!(@methods, resource)

    with :error <- Map.fetch(methods, method) do
      allowed = Enum.join(Map.keys(methods), ", ")
      {:error, Error.new(:method_not_allowed, "this resource takes #{allowed}", %{"allow" => allowed})}
    end
  end

  @doc "Runs an action. `state` has the gateway, the requester (`t:FleetWeb.API.Access.requester/0`) and its name."
  @spec run(atom() | tuple(), map(), :cowboy_req.req()) :: result()
  def run(:index, _state, request) do
    resources =
      for {path, _resource, methods} <- @resources,
          methods != %{},
          do: %{path: path, methods: Map.keys(methods)}

    {:ok, 200, %{resources: resources}, request}
  end

  def run(:openapi, _state, request), do: {:ok, 200, OpenAPI.document(), request}
  def run(:status, state, request), do: {:ok, 200, View.status(state.gateway), request}
  def run(:diagnosis, state, request), do: {:ok, 200, View.diagnosis(state.gateway), request}

  def run(:vehicles, state, request),
    do: {:ok, 200, View.vehicles(state.gateway, Request.parameters(request)["tag"]), request}

  def run(:links, state, request), do: {:ok, 200, View.links(state.gateway), request}

  def run(:vehicle, state, request), do: answer(vehicle(state, request), 200, request)

  def run(what, state, request) when what in [:events, :vehicle_events] do
    vehicle = if what == :events, do: :all, else: id(request)

    with {:ok, options} <- EventsQuery.parse(Request.parameters(request)) do
      state.gateway |> View.events(vehicle, options) |> found(unknown_vehicle())
    end
    |> answer(200, request)
  end

  def run(:signing, state, request), do: {:ok, 200, View.signing(state.gateway), request}

  def run(:vehicle_signing, state, request) do
    with {:ok, vehicle} <- vehicle(state, request) do
      found(vehicle.signing, Error.new(:not_found, "this vehicle has no key"))
    end
    |> answer(200, request)
  end

  # Waits until the vehicle uses the key, for ten seconds at most.
  def run(:sign_vehicle, state, request) do
    with {:ok, object, request} <- Request.object(request) do
      with {:ok, action, options} <- SigningRequest.parse(object), {:ok, _known} <- vehicle(state, request) do
        sign(action, state.gateway, id(request), [by: "http:#{state.name}"] ++ options)
      end
      |> answer(200, request)
    end
  end

  def run(:issue_ticket, state, request) do
    case Tickets.issue(state.gateway, state.requester) do
      {:ok, ticket, seconds} -> {:ok, %{ticket: ticket, expires_s: seconds}}
      {:error, :too_many} -> {:error, Error.new(:too_many, "too many tickets wait to be used")}
      {:error, :unavailable} -> {:error, Error.new(:unavailable, "tickets are restarting; try again")}
    end
    |> answer(201, request)
  end

  def run(:recorder, state, request) do
    state.gateway
    |> Recordings.all()
    |> found(Error.new(:not_found, "no recorder runs"))
    |> answer(200, request)
  end

  def run(:download, state, request) do
    state.gateway
    |> Recordings.download(:cowboy_req.binding(:name, request))
    |> found(Error.new(:not_found, "no recording has this name; see /api/recorder"))
    |> answer(200, request)
  end

  def run(:save, state, request) do
    with {:ok, object, request} <- Request.object(request),
         do: state.gateway |> Recordings.save(id(request), object) |> answer(201, request)
  end

  def run(what, state, request) when what in [:record_vehicle, :record_link] do
    target = {if(what == :record_link, do: :link, else: :vehicle), id(request)}

    with {:ok, object, request} <- Request.object(request),
         do: state.gateway |> Recordings.record(target, object) |> answer(200, request)
  end

  def run(:clients, state, request), do: {:ok, 200, View.clients(state.gateway), request}

  def run(:add_client, state, request) do
    with {:ok, object, request} <- Request.object(request) do
      with {:ok, client} <- ClientRequest.parse(object),
           {:ok, id} <- Client.add(state.gateway, client) do
        {:ok, %{id: id, url: client.url}}
      end
      |> answer(201, request)
    end
  end

  def run(:remove_client, state, request),
    do: state.gateway |> Client.remove(id(request)) |> answer(204, request)

  def run(:command_types, _state, request), do: {:ok, 200, %{types: Types.plain()}, request}

  # Waits for the result for at most 20 seconds.
  def run(:command, state, request) do
    with {:ok, object, body, request} <- Request.object_and_body(request) do
      wait = Request.parameters(request)["wait"]
      signed = %{header: Request.header(request, "aerie-signature"), body: body}

      case Commands.submit(state.gateway, id(request), object, wait, state.requester, signed) do
        {:ok, status, %{"id" => command} = body} -> {:ok, status, body, located(request, command)}
        {:error, error} -> {:error, error, request}
      end
    end
  end

  def run(:look_at_command, state, request),
    do: state.gateway |> Commands.look(id(request), command(request)) |> answer(200, request)

  def run(:cancel_command, state, request) do
    state.gateway |> Commands.cancel(id(request), command(request), state.requester) |> answer(202, request)
  end

  def run({:transfer, action}, state, request), do: Transfers.run(action, state, request)

  def run(:shadow, state, request), do: state.gateway |> Shadow.get(id(request)) |> answer(200, request)

  def run(:shadow_delta, state, request),
    do: state.gateway |> Shadow.delta(id(request)) |> answer(200, request)

  def run(:update_shadow, state, request) do
    with {:ok, object, request} <- Request.object(request),
         do: state.gateway |> Shadow.update(id(request), object, state.requester) |> answer(200, request)
  end

  def run(:delete_shadow, state, request) do
    version = Request.parameters(request)["version"]
    state.gateway |> Shadow.delete(id(request), version, state.requester) |> answer(200, request)
  end

  def run(:policy, state, request),
    do:
      state.gateway
      |> View.policy()
      |> found(Error.new(:not_found, "the gateway has no policy"))
      |> answer(200, request)

  def run(what, %{requester: %{role: :operator, name: name}}, request) when what in @admins,
    do:
      answer(
        {:error, Error.new(:forbidden, "the key #{name} is an operator's; this is an admin's")},
        200,
        request
      )

  def run(:add_link, state, request) do
    with {:ok, object, request} <- Request.object(request) do
      with {:ok, link} <- LinkRequest.parse(object), {:ok, id} <- Link.start(state.gateway, link) do
        {:ok, %{id: id, url: link.url}}
      end
      |> answer(201, request)
    end
  end

  def run(:remove_link, state, request) do
    if Link.get(state.gateway, id(request)),
      do: state.gateway |> Link.stop(id(request)) |> answer(204, request),
      else: answer({:error, Error.new(:not_found, "no link has this id; see /api/links")}, 204, request)
  end

  def run(:reload_config, %{reload: nil}, request),
    do:
      answer(
        {:error, Error.new(:unavailable, "this gateway has no configuration to read again")},
        200,
        request
      )

  def run(:reload_config, state, request) do
    case state.reload.("http:" <> state.name) do
      {:ok, report} ->
        {:ok, report}

      {:error, lines} ->
        message = "the configuration was not reloaded; the old one stays in force"
        {:error, %{Error.new(:invalid, message) | details: %{errors: lines}}}
    end
    |> answer(200, request)
  end

  def run(:log, _state, request), do: {:ok, 200, LogLevels.view(), request}

  def run(:change_log, _state, request) do
    with {:ok, object, request} <- Request.object(request),
         do: object |> LogLevels.change() |> answer(200, request)
  end

  def run(:reload_policy, state, request) do
    case Policy.Store.reload(state.gateway, "http:" <> state.name) do
      :ok ->
        {:ok, View.policy(state.gateway)}

      {:error, lines} ->
        {:error,
         %{
           Error.new(:invalid, "the policy was not loaded; the old one stays in force")
           | details: %{errors: lines}
         }}
    end
    |> answer(200, request)
  end

  def run(:store_plan, state, request) do
    with {:ok, text, request} <- Request.bytes(request, Shadow.max_plan_bytes()),
         do: state.gateway |> Shadow.store_plan(text, state.requester) |> answer(201, request)
  end

  def run(:operations, state, request), do: {:ok, 200, FleetOperations.list(state.gateway), request}

  def run(:operation, state, request),
    do: state.gateway |> FleetOperations.get(id(request)) |> answer(200, request)

  def run(:begin_operation, state, request) do
    with {:ok, object, request} <- Request.object(request),
         do: state.gateway |> FleetOperations.begin(object, state.requester) |> answer(202, request)
  end

  def run(:stop_operation, state, request),
    do: state.gateway |> FleetOperations.stop(id(request), state.requester) |> answer(200, request)

  def run(:rules, state, request), do: {:ok, 200, View.rules(state.gateway), request}

  def run(:change_rules, state, request) do
    with {:ok, object, request} <- Request.object(request) do
      with {:ok, changes} <- RuleChanges.parse(object),
           :ok <- Router.configure(state.gateway, id(request), changes) do
        {:ok, View.rules(state.gateway)}
      end
      |> answer(200, request)
    end
  end

  def run(:reset_rules, state, request),
    do: state.gateway |> Router.reset(id(request)) |> answer(204, request)

  defp id(request), do: :cowboy_req.binding(:id, request)
  defp command(request), do: :cowboy_req.binding(:command, request)

  # The path is made from checked values.
  defp located(request, command),
    do: :cowboy_req.set_resp_header("location", "/api/vehicles/#{id(request)}/commands/#{command}", request)

  defp vehicle(state, request), do: state.gateway |> View.vehicle(id(request)) |> found(unknown_vehicle())

  defp unknown_vehicle, do: Error.new(:not_found, "no vehicle has this name; see /api/vehicles")

  # The answer never contains a new key, which stays in the gateway's folder of keys.
  defp sign(action, gateway, id, options) do
    result =
      case action do
        :enrol -> Enrolment.enrol(gateway, id, options)
        :revoke -> Enrolment.revoke(gateway, id, options)
        :discard -> Enrolment.discard(gateway, id)
      end

    case result do
      {:ok, %{link: link}} -> {:ok, %{result: @signing_results[action], link: link}}
      :ok -> {:ok, %{result: @signing_results[action]}}
      {:error, error} -> {:error, error}
    end
  end

  defp found(nil, error), do: {:error, error}
  defp found(object, _error), do: {:ok, object}

  defp answer({:ok, object}, status, request), do: {:ok, status, object, request}
  defp answer(:ok, status, request), do: {:ok, status, nil, request}
  defp answer({:error, error}, _status, request), do: {:error, Error.from(error), request}
end
