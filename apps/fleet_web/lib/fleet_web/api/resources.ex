defmodule FleetWeb.API.Resources do
  @moduledoc "The resources below `/api`, and the action of each method of them, which `FleetWeb.API.Actions` runs."

  alias FleetWeb.API.Error

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
    {"/api/signing/capability", :signing_capability, %{"GET" => :signing_capability}},
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
  @methods Map.new(@resources, fn {_path, resource, methods} -> {resource, methods} end)

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

  @doc "The paths that take a method, and which each takes, for `/api` itself."
  @spec index() :: [%{path: String.t(), methods: [String.t()]}]
  def index do
    for {path, _resource, methods} <- @resources,
        methods != %{},
        do: %{path: path, methods: Map.keys(methods)}
  end
end
