defmodule Aerie.Console.UI.Age do
  @moduledoc "The age of a value, shown when the value is old."
  use Phoenix.Component

  @second 1_000_000

  attr :us, :integer, required: true, doc: "the age in microseconds, nil when there is no value"
  attr :limit_us, :integer, default: 3 * @second, doc: "younger values are fresh, and nothing is shown"

  @doc "The age of an old value. Its space is reserved, so that nothing moves when it appears."
  def age(assigns) do
    ~H"""
    <span class={["age", old?(@us, @limit_us) && "old"]}>{if old?(@us, @limit_us), do: text(@us)}</span>
    """
  end

  @doc "Whether a value is old; a missing one is not."
  @spec old?(integer() | nil, non_neg_integer()) :: boolean()
  def old?(nil, _limit), do: false
  def old?(us, limit), do: us >= limit

  @doc "An age in words: `4 s`, `3 min`, `2 h`, `5 d`."
  @spec text(integer() | nil) :: String.t()
  def text(nil), do: "never"
  def text(us) when us < 100 * @second, do: "#{div(max(us, 0), @second)} s"
  def text(us) when us < 100 * 60 * @second, do: "#{div(us, 60 * @second)} min"
  def text(us) when us < 48 * 3600 * @second, do: "#{div(us, 3600 * @second)} h"
  def text(us), do: "#{div(us, 24 * 3600 * @second)} d"
end
