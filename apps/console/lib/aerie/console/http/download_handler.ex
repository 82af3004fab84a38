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
  def init(request, %{policy: policy, what: what} = state) do
    facts = Request.facts(request)

    with :ok <- Admission.host(policy, facts),
         :ok <- Admission.origin(policy, facts),
         {:ok, _user} <- allowed(request, Map.fetch!(@least, what), state) do
      {:ok, answer(what, request, state), state}
    else
      {:error, :nobody} -> {:ok, :cowboy_req.reply(303, %{"location" => "/sign-in"}, "", request), state}
      {:error, {:role, least}} -> {:ok, text(request, 403, "this needs the role #{least}"), state}
      {:error, error} -> {:ok, text(request, error.status, error.message), state}
    end
  end

  defp allowed(request, least, %{gateway: gateway, server: server}) do
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

  # Names of recordings have no quotes (`MavRouter.Recorder.Archive.Name`).
  defp headers(type, name) do
    %{
      "content-type" => type,
      "content-disposition" => ~s(attachment; filename="#{name}"),
      "cache-control" => "no-store",
      "x-content-type-options" => "nosniff"
    }
  end

  defp text(request, status, words),
    do: :cowboy_req.reply(status, %{"content-type" => "text/plain; charset=utf-8"}, words <> "\n", request)
end
