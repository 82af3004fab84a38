defmodule Aerie.Fleet.Shadow do
  @moduledoc """
  The shadow of each vehicle: its desired and its reported state, and how they differ.

      {:ok, %{"version" => 3}} =
        Aerie.Fleet.Shadow.update(gateway, "VID-007", %{"desired" => %{"mode" => "LOITER"}, "reason" => "storm"}, source)

  `docs/shadow.md` describes it for users, the README in `shadow/` its parts. Answers are maps of plain values for JSON.
  """

  alias Aerie.Vehicle.Command.Error
  alias Aerie.Base.Json
  alias Aerie.Base.Names
  alias Aerie.Control.Policy.{Audit, Roles}
  alias Aerie.Fleet.Shadow.{Document, Documents, Metrics, Update}
  alias Aerie.Fleet.Shadow.Document.{Field, Tags}
  alias Aerie.Fleet.Shadow.Loop.Plans
  alias Aerie.Fleet.Shadow.Store.Buckets

  # So many fields of a change are in the audit log.
  @noted 32
  @inside Aerie.Control.Policy.Roles.principal(:gateway, "elixir", :admin)

  @typedoc """
  Why a request was refused: `:malformed` with all errors; `:role`: the source lacks a permission; `:conflict`: another
  version; `:limit`: too large; `:rate`: too many; `:unavailable`: it cannot be stored now.
  """
  @type refusal ::
          {:malformed, [Error.t(), ...]}
          | {:role | :conflict | :limit | :rate | :unavailable, String.t()}

  @doc "Desired and reported state of a vehicle, with the state of each desired field."
  @spec get(Names.gateway(), String.t()) :: {:ok, map()} | {:error, refusal()}
  def get(gateway, vehicle) do
    with :ok <- known(vehicle),
         {:ok, document} <- Documents.fetch(gateway, vehicle),
         do: {:ok, whole(gateway, document, reported(gateway, vehicle))}
  end

  @doc """
  The same without asking anybody, as often as somebody looks; `:elsewhere` for a vehicle that this gateway does not hear, if it is not
  the only place where documents are.
  """
  @spec status(Names.gateway(), String.t()) :: {:ok, map()} | :elsewhere
  def status(gateway, vehicle) do
    document = Documents.document(gateway, vehicle)
    report = Documents.reported(gateway, vehicle)

    if report != nil or document.version > 0,
      do: {:ok, whole(gateway, document, own(report))},
      else: :elsewhere
  end

  @doc "The answer of `get/2` for a vehicle without desired or known state."
  @spec nothing(String.t()) :: map()
  def nothing(vehicle),
    do: vehicle |> Document.new() |> desired() |> Map.merge(%{"history" => [], "reported" => nil})

  defp whole(gateway, document, reported) do
    document
    |> desired()
    |> Map.merge(%{
      "history" => Document.plain(document)["history"],
      "reported" => reported,
      "problem" => Documents.problem(gateway)
    })
  end

  # The gateway that acts on the vehicle has the most recent report.
  defp reported(gateway, vehicle) do
    case {Documents.authority(gateway, vehicle), Documents.reported(gateway, vehicle),
          Documents.nats(gateway)} do
      {:mine, {_fields, reported}, _nats} -> reported
      {_other, own, {conn, environment}} -> Buckets.reported(conn, environment, vehicle) || own(own)
      {_other, own, nil} -> own(own)
    end
  catch
    :exit, _gone -> nil
  end

  defp own({_fields, reported}), do: reported
  defp own(nil), do: nil

  @doc "The desired fields of a vehicle that differ, with the reasons."
  @spec delta(Names.gateway(), String.t()) :: {:ok, map()} | {:error, refusal()}
  def delta(gateway, vehicle) do
    with :ok <- known(vehicle), {:ok, document} <- Documents.fetch(gateway, vehicle) do
      fields = (reported(gateway, vehicle) || %{})["fields"] || %{}
      differing = Map.reject(fields, fn {_path, status} -> status["state"] == "converged" end)
      delta = for {path, status} <- differing, into: %{}, do: {path, status["desired"]}

      {:ok,
       %{
         "vehicle" => vehicle,
         "version" => document.version,
         "delta" => Field.nested(delta),
         "fields" => differing
       }}
    end
  end

  @doc """
  Changes the desired state (`Aerie.Fleet.Shadow.Update`) in the name of `source`, which must have the permission of each field that is
  set or removed. Returns the new desired state.
  """
  @spec update(Names.gateway(), String.t(), term(), Roles.source(), via :: String.t()) ::
          {:ok, map()} | {:error, refusal()}
  def update(gateway, vehicle, request, source \\ @inside, via \\ "elixir"),
    do: change(gateway, vehicle, Update.parse(request, now()), source, via)

  @doc "Removes all fields, so that nothing is desired. The version is incremented."
  @spec delete(Names.gateway(), String.t(), term(), Roles.source(), via :: String.t()) ::
          {:ok, map()} | {:error, refusal()}
  def delete(gateway, vehicle, request \\ %{}, source \\ @inside, via \\ "elixir"),
    do: change(gateway, vehicle, Update.parse_delete(request, now()), source, via)

  defp change(gateway, vehicle, parsed, source, via) do
    author = %{actor: source.name, via: via}

    with :ok <- known(vehicle),
         {:ok, update} <- parsed(parsed),
         :ok <- rate(gateway, source),
         {:ok, document} <- Documents.change(gateway, vehicle, &apply(&1, update, author, source)) do
      updated(gateway, document, source, via)
      {:ok, document |> desired() |> Map.put("token", update.token)}
    else
      {:error, refusal} ->
        refused(gateway, vehicle, source, via, refusal)
        {:error, refusal}
    end
  end

  defp known(vehicle) do
    if is_binary(vehicle) and vehicle =~ ~r/\A[A-Za-z0-9_-]{1,64}\z/,
      do: :ok,
      else: {:error, {:malformed, [Error.new("vehicle", "1 to 64 letters, digits, - and _", vehicle)]}}
  end

  defp parsed({:ok, update}), do: {:ok, update}
  defp parsed({:error, errors}), do: {:error, {:malformed, errors}}

  # Checked against the present document: removing all fields needs the permissions of all of them.
  defp apply(document, update, author, source) do
    with :ok <- permitted(document, update, source), do: Document.apply(document, update, author, now())
  end

  defp permitted(document, update, source) do
    all? = Enum.all?(Field.all(), &(Map.get(update.changes, &1.name, :kept) == nil))

    changes =
      if all?, do: Map.new(document.fields, fn {path, _field} -> {path, nil} end), else: update.changes

    needed =
      for {path, value} <- changes, permission <- Field.permissions(path, value), do: {path, permission}

    lacking = Enum.find(needed, fn {_path, permission} -> not Roles.allowed?(source, permission) end)

    cond do
      lacking != nil ->
        {path, permission} = lacking
        {:error, {:role, "#{path} needs the permission #{permission}, which #{source.name} does not have"}}

      source.role == :viewer ->
        {:error, {:role, "a viewer may not change anything"}}

      true ->
        :ok
    end
  end

  defp rate(gateway, source) do
    with :none <- Documents.rate(gateway, source.name),
         do:
           {:error, {:rate, "#{source.name} changes desired states too often; 10 times a second are allowed"}}
  end

  defp updated(gateway, document, source, via) do
    Metrics.count(gateway, :updates)
    [change | _older] = document.history

    Audit.note(gateway, %{
      "type" => "desired",
      "vehicle" => document.vehicle,
      "version" => document.version,
      "source" => source.name,
      "via" => via,
      "set" => Enum.take(change.set, @noted),
      "removed" => Enum.take(change.removed, @noted)
    })

    :telemetry.execute([:aerie, :shadow, :updated], %{version: document.version}, %{
      gateway: gateway,
      vehicle: document.vehicle,
      actor: source.name,
      via: via,
      set: length(change.set),
      removed: length(change.removed)
    })
  end

  defp refused(gateway, vehicle, source, via, refusal) do
    Metrics.count(gateway, :updates_refused)

    _ =
      with {:role, why} <- refusal do
        entry = %{"type" => "desired", "vehicle" => vehicle, "source" => source.name, "via" => via}
        Audit.refusal(gateway, source, {:deny, :role, why}, entry)
      end

    metadata = %{gateway: gateway, vehicle: vehicle, actor: source.name, via: via, reason: text(refusal)}
    :telemetry.execute([:aerie, :shadow, :refused], %{count: 1}, metadata)
  end

  @doc "The tags of all vehicles that have some, by name; of those that other gateways hear too."
  @spec tags(Names.gateway()) :: Tags.tags()
  defdelegate tags(gateway), to: Documents

  @doc "Every field that a desired state may have."
  @spec fields() :: [Field.t()]
  defdelegate fields, to: Field, as: :all

  @doc "The field of a path."
  @spec field(String.t()) :: {:ok, Field.t()} | :error
  defdelegate field(path), to: Field, as: :fetch

  @doc "Values by their paths as a document: `%{\"home.lat\" => 47.1}` is `%{\"home\" => %{\"lat\" => 47.1}}`."
  @spec nested(%{String.t() => term()}) :: map()
  defdelegate nested(values), to: Field

  @doc "Words as tags: trimmed, sorted, each once."
  @spec tidy_tags([String.t()]) :: [String.t()]
  defdelegate tidy_tags(words), to: Tags, as: :tidy

  @doc "Every tag that some vehicle has."
  @spec all_tags(Tags.tags()) :: [String.t()]
  defdelegate all_tags(tags), to: Tags, as: :all

  @doc "Gives a vehicle these tags in place of those that it has; `[]` takes them away. Otherwise as `update/5`."
  @spec tag(Names.gateway(), String.t(), [String.t()], Roles.source(), via :: String.t()) ::
          :ok | {:error, refusal()}
  def tag(gateway, vehicle, words, source \\ @inside, via \\ "elixir") do
    tags = with [] <- Tags.tidy(words), do: nil

    with {:ok, _desired} <- update(gateway, vehicle, %{"desired" => %{"tags" => tags}}, source, via),
         do: :ok
  end

  @doc "The text of a refusal."
  @spec text(refusal()) :: String.t()
  def text({:malformed, errors}), do: Enum.join(errors, "; ")
  def text({_kind, text}), do: text

  defp desired(document) do
    plain = Document.plain(document)
    values = Map.new(Document.live(document, now()), fn {path, entry} -> {path, entry.value} end)

    %{
      "vehicle" => document.vehicle,
      "version" => document.version,
      "updated_at" => Json.time(document.updated_at),
      "desired" => Field.nested(values),
      "set" => Map.new(plain["fields"], fn {path, entry} -> {path, Map.delete(entry, "value")} end)
    }
  end

  @doc "The largest file that `put_plan/3` stores, in bytes."
  @spec max_plan_bytes() :: pos_integer()
  defdelegate max_plan_bytes, to: Plans, as: :max_bytes

  @doc "Stores a `.plan` file for `mission.plan` and `geofence.plan`, and returns its hash. Needs the permission `mission`."
  @spec put_plan(Names.gateway(), text :: binary(), Roles.source()) ::
          {:ok, hash :: String.t()} | {:error, {:role | :invalid | :unavailable, String.t()}}
  def put_plan(gateway, text, source \\ @inside) do
    if Roles.allowed?(source, :mission),
      do: Plans.put(gateway, text),
      else:
        {:error, {:role, "to store plans needs the permission mission, which #{source.name} does not have"}}
  end

  @doc "The metrics of the shadow."
  @spec metrics(Names.gateway()) :: [Metrics.metric()]
  def metrics(gateway), do: Metrics.all(gateway, Documents.reports(gateway))

  @doc "Whether these metrics show a counter of the read model."
  @spec counter?(term()) :: boolean()
  defdelegate counter?(name), to: Metrics, as: :own?

  @doc "The state of a vehicle's fields from this gateway's loop; empty without one."
  @spec report(Names.gateway(), String.t()) :: Aerie.Fleet.Shadow.Loop.Reconcile.report()
  def report(gateway, vehicle) do
    with {fields, _document} <- Documents.reported(gateway, vehicle), do: fields, else: (nil -> %{})
  end

  @doc """
  The states of those of these fields that are wanted of a vehicle; `:unseen`: wanted, and no loop of this gateway
  reports it.
  """
  @spec wanted(Names.gateway(), String.t(), [String.t()]) :: %{String.t() => atom()}
  def wanted(gateway, vehicle, paths) do
    case gateway |> Documents.document(vehicle) |> Document.live(now()) |> Map.take(paths) do
      none when none == %{} ->
        %{}

      wanted ->
        report = report(gateway, vehicle)
        Map.new(wanted, fn {path, _entry} -> {path, get_in(report, [path, :state]) || :unseen} end)
    end
  end

  defp now, do: System.os_time(:microsecond)
end
