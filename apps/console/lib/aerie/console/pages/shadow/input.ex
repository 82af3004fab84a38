defmodule Aerie.Console.Pages.Shadow.Input do
  @moduledoc "The form by which something is desired: which field, as text, for how long. Pure. What is wrong about a value, the shadow itself says."

  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Shadow

  @expiries [
    {"never", ""},
    {"in 10 minutes", "600"},
    {"in an hour", "3600"},
    {"in 8 hours", "28800"},
    {"in a day", "86400"}
  ]

  @doc "Names of the fields that a user may set; `params.*` and `intervals.*` take a name of their own."
  @spec fields(Roles.source()) :: [String.t()]
  def fields(%{role: :viewer}), do: []
  def fields(user), do: for(field <- Shadow.fields(), Roles.allowed?(user, field.permission), do: field.name)

  @doc "For how long something can be desired, as options of a select."
  @spec expiries() :: [{String.t(), String.t()}]
  def expiries, do: @expiries

  @doc "The form for a field, empty or with what is desired of it now."
  @spec form(String.t(), String.t()) :: map()
  def form(path, value \\ "") do
    {field, name} =
      case String.split(path, ".", parts: 2) do
        [group, child] when group in ["params", "intervals"] and child != "*" -> {group <> ".*", child}
        _leaf -> {path, ""}
      end

    %{"field" => field, "name" => name, "value" => value, "expires" => "", "reason" => ""}
  end

  @doc "The request of a form (`Aerie.Fleet.Shadow.update/5`), for the version that was shown."
  @spec request(map(), version :: integer()) :: {:ok, map()} | {:error, String.t()}
  def request(form, version) do
    with {:ok, path} <- path(form["field"], form["name"]), {:ok, field} <- field(path) do
      value = value(field.name, String.trim(form["value"] || ""))
      {:ok, Map.put(common(form, version), "desired", Shadow.nested(%{path => value}))}
    end
  end

  @doc "The version that a form names; one that never was for anything else, so that its change is refused."
  @spec version(term()) :: integer()
  def version(text) when is_binary(text) do
    case Integer.parse(text) do
      {version, ""} -> version
      _other -> -1
    end
  end

  def version(_other), do: -1

  @doc "The request to remove a field."
  @spec removal(String.t(), version :: integer()) :: map()
  def removal(path, version), do: %{"desired" => Shadow.nested(%{path => nil}), "version" => version}

  defp common(form, version) do
    reason = String.trim(form["reason"] || "")
    seconds = with {seconds, ""} <- Integer.parse(form["expires"] || ""), do: seconds, else: (_never -> nil)
    %{"version" => version, "reason" => if(reason != "", do: reason), "expires_in_s" => seconds}
  end

  defp path(nil, _name), do: {:error, "choose a field"}

  defp path(field, name) do
    case {String.split(field, "*"), String.trim(name || "")} do
      {[path], _name} -> {:ok, path}
      {[_group, ""], ""} -> {:error, "#{field} needs the name of a parameter or message"}
      {[group, ""], name} -> {:ok, group <> String.upcase(name)}
      _other -> {:error, "choose a field"}
    end
  end

  defp field(path) do
    with :error <- Shadow.field(path),
         do: {:error, "#{String.slice(path, 0, 60)} is not a field: see docs/shadow.md"}
  end

  defp value("tags", text), do: text |> String.split(",") |> Shadow.tidy_tags()

  defp value("home", text) do
    case text |> String.split(",") |> Enum.map(&number(String.trim(&1))) do
      [lat, lon, altitude] -> %{"lat" => lat, "lon" => lon, "altitude_msl" => altitude}
      _other -> text
    end
  end

  defp value(name, "true") when name in ["recorder", "signing", "armed", "geofence.enabled"], do: true
  defp value(name, "false") when name in ["recorder", "signing", "armed", "geofence.enabled"], do: false
  defp value(name, text) when name in ["params.*", "intervals.*"], do: number(text)
  defp value(_text, text), do: text

  # A text that is not a number stays one; the shadow refuses it and says what it expects.
  defp number(text) do
    case {Integer.parse(text), Float.parse(text)} do
      {{number, ""}, _float} -> number
      {_integer, {number, ""}} -> number
      _neither -> text
    end
  end
end
