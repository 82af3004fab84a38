defmodule FleetWeb.API.Resources do
  @moduledoc "The resources below `/api`, the methods that each takes, and what they do."

  alias Aerie.{Client, Enrolment, Router}

  alias FleetWeb.API.{
    Error,
    EventsQuery,
    NewClient,
    Recordings,
    Request,
    RuleChanges,
    SigningOrder,
    Tickets,
    View
  }

  @resources [
    {"/api", :index, %{"GET" => :index}},
    {"/api/status", :status, %{"GET" => :status}},
    {"/api/vehicles", :vehicles, %{"GET" => :vehicles}},
    {"/api/vehicles/:id", :vehicle, %{"GET" => :vehicle}},
    {"/api/vehicles/:id/events", :vehicle_events, %{"GET" => :vehicle_events}},
    {"/api/events", :events, %{"GET" => :events}},
    {"/api/vehicles/:id/save", :save, %{"POST" => :save}},
    {"/api/vehicles/:id/recording", :vehicle_recording, %{"PUT" => :record_vehicle}},
    {"/api/vehicles/:id/signing", :vehicle_signing, %{"GET" => :vehicle_signing, "POST" => :sign_vehicle}},
    {"/api/signing", :signing, %{"GET" => :signing}},
    {"/api/links", :links, %{"GET" => :links}},
    {"/api/links/:id/recording", :link_recording, %{"PUT" => :record_link}},
    {"/api/recorder", :recorder, %{"GET" => :recorder}},
    {"/api/recordings/:name", :recording, %{"GET" => :download}},
    {"/api/clients", :clients, %{"GET" => :clients, "POST" => :add_client}},
    {"/api/clients/:id", :client, %{"DELETE" => :remove_client}},
    {"/api/rules", :rules, %{"GET" => :rules}},
    {"/api/rules/:id", :rule, %{"PATCH" => :change_rules, "DELETE" => :reset_rules}},
    {"/api/tickets", :tickets, %{"POST" => :issue_ticket}},
    {"/api/[...]", :missing, %{}}
  ]
  @methods Map.new(@resources, fn {_path, resource, methods} -> {resource, methods} end)

  @typedoc "A body is an object, a file as `{:file, path, bytes}`, or nothing."
  @type result ::
          {:ok, 200..299, map() | {:file, Path.t(), non_neg_integer()} | nil, :cowboy_req.req()}
          | {:error, Error.t(), :cowboy_req.req()}

  @doc "Cowboy's paths, each with the name of its resource."
  @spec paths() :: [{String.t(), atom()}]
  def paths, do: for({path, resource, _methods} <- @resources, do: {path, resource})

  @doc "The methods that a resource takes; HEAD if it takes GET."
  @spec methods(atom()) :: [String.t()]
  def methods(resource) do
    methods = Map.keys(Map.fetch!(@methods, resource))
    if "GET" in methods, do: methods ++ ["HEAD"], else: methods
  end

  @doc "The action of a method on a resource. HEAD is GET; Cowboy leaves out the body."
  @spec action(atom(), String.t()) :: {:ok, atom()} | {:error, Error.t()}
  def action(:missing, _method), do: {:error, Error.new(:not_found, "there is no such resource; see /api")}
  def action(resource, "HEAD"), do: action(resource, "GET")

  def action(resource, method) do
    methods = Map.fetch!(@methods, resource)

    with :error <- Map.fetch(methods, method) do
      allowed = Enum.join(Map.keys(methods), ", ")
      {:error, Error.new(:method_not_allowed, "this resource takes #{allowed}", %{"allow" => allowed})}
    end
  end

  @doc "Runs an action. `state` has the gateway and the requester's name."
  @spec run(atom(), map(), :cowboy_req.req()) :: result()
  def run(:index, _state, request) do
    resources =
      for {path, _resource, methods} <- @resources,
          methods != %{},
          do: %{path: path, methods: Map.keys(methods)}

    {:ok, 200, %{resources: resources}, request}
  end

  def run(:status, state, request), do: {:ok, 200, View.status(state.gateway), request}
  def run(:vehicles, state, request), do: {:ok, 200, View.vehicles(state.gateway), request}
  def run(:links, state, request), do: {:ok, 200, View.links(state.gateway), request}

  def run(:vehicle, state, request) do
    case View.vehicle(state.gateway, :cowboy_req.binding(:id, request)) do
      nil -> {:error, unheard(), request}
      vehicle -> {:ok, 200, vehicle, request}
    end
  end

  def run(what, state, request) when what in [:events, :vehicle_events] do
    vehicle = if what == :events, do: :all, else: :cowboy_req.binding(:id, request)

    with {:ok, options} <- EventsQuery.parse(Request.parameters(request)),
         events when is_map(events) <- View.events(state.gateway, vehicle, options) do
      {:ok, 200, events, request}
    else
      nil -> {:error, unheard(), request}
      {:error, error} -> {:error, error, request}
    end
  end

  def run(:signing, state, request), do: {:ok, 200, View.signing(state.gateway), request}

  def run(:vehicle_signing, state, request) do
    case View.vehicle(state.gateway, :cowboy_req.binding(:id, request)) do
      nil -> {:error, unheard(), request}
      %{signing: nil} -> {:error, Error.new(:not_found, "this vehicle has no key"), request}
      %{signing: signing} -> {:ok, 200, signing, request}
    end
  end

  # Waits until the vehicle is seen to use the key, for ten seconds at most.
  def run(:sign_vehicle, state, request) do
    id = :cowboy_req.binding(:id, request)

    with {:ok, object, request} <- Request.object(request) do
      case sign(state, id, SigningOrder.parse(object)) do
        {:ok, answer} -> {:ok, 200, answer, request}
        {:error, %Error{} = error} -> {:error, error, request}
        {:error, words} -> {:error, Error.new(:invalid, words), request}
      end
    end
  end

  def run(:issue_ticket, state, request) do
    case Tickets.issue(state.gateway, state.name) do
      {:ok, ticket, seconds} ->
        {:ok, 201, %{ticket: ticket, expires_s: seconds}, request}

      {:error, :too_many} ->
        {:error, Error.new(:too_many, "too many tickets wait to be used"), request}

      {:error, :unavailable} ->
        {:error, Error.new(:unavailable, "tickets are restarting; try again"), request}
    end
  end

  def run(:recorder, state, request), do: found(Recordings.all(state.gateway), "no recorder runs", request)

  def run(:download, state, request) do
    name = :cowboy_req.binding(:name, request)
    found(Recordings.download(state.gateway, name), "no recording has this name; see /api/recorder", request)
  end

  def run(:save, state, request) do
    with {:ok, object, request} <- Request.object(request),
         do: done(Recordings.save(state.gateway, :cowboy_req.binding(:id, request), object), 201, request)
  end

  def run(what, state, request) when what in [:record_vehicle, :record_link] do
    target = {if(what == :record_link, do: :link, else: :vehicle), :cowboy_req.binding(:id, request)}

    with {:ok, object, request} <- Request.object(request),
         do: done(Recordings.record(state.gateway, target, object), 200, request)
  end

  def run(:clients, state, request), do: {:ok, 200, View.clients(state.gateway), request}

  def run(:add_client, state, request) do
    with {:ok, object, request} <- Request.object(request) do
      case add(state.gateway, object) do
        {:ok, created} -> {:ok, 201, created, request}
        {:error, error} -> {:error, error, request}
      end
    end
  end

  def run(:remove_client, state, request) do
    case Client.remove(state.gateway, :cowboy_req.binding(:id, request)) do
      :ok ->
        {:ok, 204, nil, request}

      {:error, :unknown} ->
        {:error, Error.new(:not_found, "no client has this id; see /api/clients"), request}

      {:error, :for_vehicles} ->
        {:error, Error.new(:conflict, "this is a link to vehicles"), request}
    end
  end

  def run(:rules, state, request), do: {:ok, 200, View.rules(state.gateway), request}

  def run(:change_rules, state, request) do
    id = :cowboy_req.binding(:id, request)

    with {:ok, object, request} <- Request.object(request) do
      with {:ok, changes} <- RuleChanges.parse(object), :ok <- Router.configure(state.gateway, id, changes) do
        {:ok, 200, View.rules(state.gateway), request}
      else
        {:error, %Error{} = error} -> {:error, error, request}
        {:error, words} -> {:error, rules(words), request}
      end
    end
  end

  def run(:reset_rules, state, request) do
    case Router.reset(state.gateway, :cowboy_req.binding(:id, request)) do
      :ok -> {:ok, 204, nil, request}
      {:error, words} -> {:error, rules(words), request}
    end
  end

  defp rules("there is no link" <> _ = words), do: Error.new(:not_found, words)
  defp rules(words), do: Error.new(:invalid, words)

  defp unheard, do: Error.new(:not_found, "no vehicle has this name; see /api/vehicles")

  # The answer never contains a new key; it stays in the gateway's folder of keys.
  defp sign(%{gateway: gateway, name: name}, id, {:ok, action, options}) do
    options = [by: "http:#{name}"] ++ options

    case {View.vehicle(gateway, id), action} do
      {nil, _action} ->
        {:error, unheard()}

      {_known, :enrol} ->
        done(Enrolment.enrol(gateway, id, options), "enrolled")

      {_known, :revoke} ->
        done(Enrolment.revoke(gateway, id, options), "revoked")

      {_known, :discard} ->
        with(:ok <- Enrolment.discard(gateway, id), do: {:ok, %{result: "discarded"}})
    end
  end

  defp sign(_state, _id, {:error, error}), do: {:error, error}

  defp done({:ok, %{link: link}}, result), do: {:ok, %{result: result, link: link}}
  defp done({:error, words}, _result), do: {:error, words}

  defp add(gateway, object) do
    with {:ok, url, options} <- NewClient.parse(object) do
      case Client.add(gateway, url, options) do
        {:ok, id} -> {:ok, %{id: id, url: url}}
        {:error, words} -> {:error, Error.new(if(words =~ "already", do: :conflict, else: :invalid), words)}
      end
    end
  end

  defp found(nil, words, request), do: {:error, Error.new(:not_found, words), request}
  defp found(object, _words, request), do: {:ok, 200, object, request}

  defp done({:ok, object}, status, request), do: {:ok, status, object, request}
  defp done({:error, error}, _status, request), do: {:error, error, request}
end
