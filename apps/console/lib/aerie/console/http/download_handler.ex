defmodule Aerie.Console.HTTP.DownloadHandler do
  @moduledoc """
  Serves files to signed-in users: `/download/recordings/NAME` (a recording, for viewers) and `/download/audit` (the whole audit log, for admins). A
  file is sent by the kernel, not through memory.
  """

  @behaviour :cowboy_handler

  alias Aerie.Control.Policy.Audit
  alias Aerie.Access.HTTP.{Admission, Request}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Session
  alias MavRouter.Recorder
  alias Phoenix.LiveView.Cookie

  @least %{recording: :viewer, audit: :admin}

  @impl :cowboy_handler
  def init(request, %{what: what} = state) do
    case allowed(request, Map.fetch!(@least, what), state) do
      {:ok, _user} -> {:ok, answer(what, request, state), state}
      {:refused, request} -> {:ok, request, state}
    end
  end

  @doc "The user of a request from a page of ours who has at least this role; anything else is answered."
  @spec allowed(:cowboy_req.req(), Roles.role(), map()) :: {:ok, map()} | {:refused, :cowboy_req.req()}
  def allowed(request, least, %{policy: policy} = access) do
    facts = Request.facts(request)

    with :ok <- Admission.host(policy, facts),
         :ok <- Admission.origin(policy, facts),
         {:ok, user} <- user(request, least, access) do
      {:ok, user}
    else
      {:error, :nobody} -> {:refused, :cowboy_req.reply(303, %{"location" => "/sign-in"}, "", request)}
      {:error, {:role, least}} -> {:refused, text(request, 403, "this needs the role #{least}")}
      {:error, error} -> {:refused, text(request, error.status, error.message)}
    end
  end

  defp user(request, least, %{gateway: gateway, server: server}) do
    case Session.user(gateway, Cookie.read(request, server.secret, server.cookie)) do
      nil -> {:error, :nobody}
      user -> if Roles.at_least?(user.role, least), do: {:ok, user}, else: {:error, {:role, least}}
    end
  end

  defp answer(:recording, request, %{gateway: gateway}) do
    name = :cowboy_req.binding(:name, request)

    case Recorder.find(gateway, name) do
      %{file: path, bytes: bytes} ->
        :cowboy_req.reply(
          200,
          headers("application/octet-stream", name),
          {:sendfile, 0, bytes, path},
          request
        )

      nil ->
        text(request, 404, "there is no such recording")
    end
  end

  defp answer(:audit, request, %{gateway: gateway}) do
    case Audit.status(gateway) do
      {:ok, %{dir: dir}} ->
        request = :cowboy_req.stream_reply(200, headers("application/x-ndjson", "audit.jsonl"), request)

        for {path, bytes} <- Audit.files(dir),
            bytes > 0,
            do: :cowboy_req.stream_body({:sendfile, 0, bytes, path}, :nofin, request)

        :cowboy_req.stream_body("", :fin, request)
        request

      {:error, words} ->
        text(request, 503, words)
    end
  end

  @doc "The headers of a file. Names of recordings (`MavRouter.Recorder.Archive.Name`) and vehicles have no quotes."
  @spec headers(type :: String.t(), name :: String.t()) :: %{String.t() => String.t()}
  def headers(type, name) do
    %{
      "content-type" => type,
      "content-disposition" => ~s(attachment; filename="#{name}"),
      "cache-control" => "no-store",
      "x-content-type-options" => "nosniff"
    }
  end

  @doc "An answer in words."
  @spec text(:cowboy_req.req(), status :: 400..599, String.t()) :: :cowboy_req.req()
  def text(request, status, words),
    do: :cowboy_req.reply(status, %{"content-type" => "text/plain; charset=utf-8"}, words <> "\n", request)
end
