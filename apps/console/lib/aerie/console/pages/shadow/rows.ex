defmodule Aerie.Console.Pages.Shadow.Rows do
  @moduledoc "A shadow (`Aerie.Fleet.Shadow.status/2`) as its page shows it: a row for each desired field. Pure."

  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Shadow
  alias Aerie.Console.Clock

  @typedoc """
    * `:desired`, `:actual` - as text; `:actual` is nil where it is not known
    * `:state` - `converged`, `pending`, `held`, `refused`; nil while no gateway has compared it
    * `:why` - in words, with its holder and until when
    * `:set` - who set it, when, and why
    * `:able` - whether the user may change it
  """
  @type row :: %{
          path: String.t(),
          desired: String.t(),
          actual: String.t() | nil,
          state: String.t() | nil,
          why: String.t() | nil,
          set: String.t(),
          expires: String.t() | nil,
          able: boolean()
        }

  @doc "The rows, those that do not agree first."
  @spec rows(map(), Roles.source()) :: [row()]
  def rows(shadow, user) do
    statuses = (shadow["reported"] || %{})["fields"] || %{}

    for {path, set} <- shadow["set"] do
      status = statuses[path] || %{}
      # The comparison may be with an older desired value.
      status = if status["version"] in [nil, set["version"]], do: status, else: %{}

      %{
        path: path,
        desired: text(at(shadow["desired"], path)),
        actual:
          with(
            %{} = reported <- shadow["reported"],
            value when value != nil <- at(reported, path),
            do: text(value)
          ),
        state: status["state"],
        why: why(status),
        set: set(set),
        expires: set["expires_at"] && Clock.full(set["expires_at"]),
        able: able?(user, path)
      }
    end
    |> Enum.sort_by(&{&1.state == "converged", &1.path})
  end

  defp able?(user, path) do
    case Shadow.field(path) do
      {:ok, field} -> Roles.allowed?(user, field.permission)
      :error -> false
    end
  end

  @doc "The value of a path in a nested object."
  @spec at(map() | nil, String.t()) :: term()
  def at(nil, _path), do: nil

  def at(object, path) do
    case String.split(path, ".", parts: 2) do
      [group, child] -> with %{} = below <- object[group], do: below[child], else: (_none -> nil)
      [name] -> object[name]
    end
  end

  defp why(status) do
    parts = [
      status["by"] && "by #{status["by"]}",
      status["why"],
      status["until"] && "until #{Clock.full(status["until"])}"
    ]

    with [_ | _] = parts <- Enum.filter(parts, & &1), do: Enum.join(parts, ", "), else: ([] -> nil)
  end

  @doc "By whom and why something was changed."
  @spec set(map()) :: String.t()
  def set(%{"actor" => actor, "via" => via, "at" => at, "reason" => reason}),
    do: "#{actor} (#{via}), #{Clock.full(at)}#{if reason, do: ": " <> reason}"

  @doc "A value as it is typed (`Aerie.Console.Pages.Shadow.Input`)."
  @spec text(term()) :: String.t()
  def text(value) when is_list(value), do: Enum.map_join(value, ", ", &text/1)
  def text(value) when is_binary(value), do: value
  def text(%{"lat" => lat, "lon" => lon} = place), do: "#{lat}, #{lon}, #{place["altitude_msl"]}"

  def text(value) when is_float(value) and trunc(value) == value and abs(value) < 1.0e15,
    do: "#{trunc(value)}"

  def text(value) when is_number(value) or is_boolean(value), do: to_string(value)
  def text(value), do: JSON.encode!(value)
end
