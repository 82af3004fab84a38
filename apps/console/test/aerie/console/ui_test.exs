defmodule Aerie.Console.UITest do
  use ExUnit.Case, async: true

  use Aerie.Console, :component
  import Phoenix.LiveViewTest, only: [rendered_to_string: 1]

  alias Aerie.Console.UI.{Age, Icon}

  @css Path.expand("../../../assets/css", __DIR__)

  defp html(rendered), do: rendered_to_string(rendered)

  test "every icon is drawn; an unknown one is a mistake of the page" do
    for name <- Icon.names() do
      assigns = %{name: name}
      assert html(~H"<.icon name={@name} />") =~ ~r/<path d="[Mm]/
    end

    assigns = %{}
    assert_raise KeyError, fn -> html(~H|<.icon name="nothing" />|) end
  end

  test "what is not seen of a vehicle's text, and changes what is, has a sign" do
    unseen = [
      "\e",
      "\u009B",
      "\u061C",
      "\u200E",
      "\u200F",
      "\u202E",
      "\u2066",
      "\u2067",
      "\u2068",
      "\u2069",
      "\u2028"
    ]

    for sign <- unseen do
      assigns = %{text: "gpj#{sign}exe"}
      assert html(~H|<b title={@text}>{@text}</b>|) == ~s|<b title="gpj\uFFFDexe">gpj\uFFFDexe</b>|
    end

    assigns = %{text: "Flüge\t東\n\u{1F681} & <b>"}
    assert html(~H|{@text}|) == "Flüge\t東\n\u{1F681} &amp; &lt;b&gt;"
  end

  test "an age is shown when it matters, in words that keep their length" do
    assert Age.text(nil) == "never"
    assert Age.text(0) == "0 s"
    assert Age.text(99_000_000) == "99 s"
    assert Age.text(100_000_000) == "1 min"
    assert Age.text(7_200_000_000) == "2 h"
    assert Age.text(3 * 86_400_000_000) == "3 d"
    refute Age.old?(nil, 0)

    assigns = %{}
    refute html(~H"<.age us={2_999_999} />") =~ " s"
    assert html(~H"<.age us={3_000_000} />") =~ "3 s"
  end

  test "a meter has its value in words too, and none for what is not known" do
    assigns = %{}
    assert html(~H|<.meter value={0.756} label="Battery" />|) =~ "76 %"
    unknown = html(~H|<.meter value={nil} label="Battery" />|)
    assert unknown =~ "–"
    refute unknown =~ ~s(role="meter")
    assert html(~H|<.meter value={1.7} label="x" />|) =~ "100 %"
  end

  test "a button is a button or a link; with an icon alone it has a name" do
    assigns = %{}
    assert html(~H|<.button phx-click="x">Go</.button>|) =~ ~s(type="button")
    assert html(~H|<.button navigate="/alarms">Go</.button>|) =~ ~s(href="/alarms")
    assert html(~H|<.button icon="x" label="Close" />|) =~ ~s(aria-label="Close")
  end

  test "a hold button says its event, its time and its key, and why it is off" do
    assigns = %{}
    held = html(~H|<.hold_button id="b" event="land" shortcut="l" phx-value-vehicle="V">Land</.hold_button>|)

    for part <- [~s(data-event="land"), ~s(data-hold="800"), ~s(data-shortcut="l"), ~s(phx-value-vehicle="V")],
        do: assert(held =~ part)

    refute held =~ "phx-click"
    off = html(~H|<.hold_button id="b" event="land" disabled reason="not armed">Land</.hold_button>|)
    assert off =~ "disabled" and off =~ ~s(title="not armed")
  end

  test "a table names its columns in each cell, for phones, and says how it is sorted" do
    assigns = %{rows: [%{id: 1}]}

    table =
      html(~H"""
      <.data_table id="t" label="Things" rows={@rows} row_id={&"t-#{&1.id}"} sort={{"id", :desc}}>
        <:col :let={row} label="Number" sort="id" number>{row.id}</:col>
      </.data_table>
      """)

    for part <- [
          ~s(id="t-1"),
          ~s(data-label="Number"),
          ~s(aria-sort="descending"),
          ~s(phx-value-by="id"),
          "<caption",
          # A box that scrolls is reached by the keyboard (F29).
          ~s(class="table-box" tabindex="0" role="group" aria-label="Things")
        ],
        do: assert(table =~ part)
  end

  test "a field is tied to its label, its hint and what is wrong with it" do
    assigns = %{}

    field =
      html(~H|<.field id="f" name="f" label="Height" unit="m" hint="above home" errors={["too high"]} />|)

    for part <- [
          ~s(for="f"),
          ~s(aria-describedby="f-hint f-errors"),
          ~s(aria-invalid="true"),
          "too high",
          "above home"
        ],
        do: assert(field =~ part)

    assert html(~H|<.field id="s" name="s" type="select" label="S" options={["a", "b"]} value="b" />|) =~
             "selected"
  end

  describe "the colours" do
    # WCAG: relative luminance, and the contrast of two.
    defp luminance("#" <> hex) do
      for(<<pair::binary-2 <- hex>>, do: String.to_integer(pair, 16) / 255)
      |> Enum.map(fn c -> if c <= 0.04045, do: c / 12.92, else: :math.pow((c + 0.055) / 1.055, 2.4) end)
      |> Enum.zip_reduce([0.2126, 0.7152, 0.0722], 0, fn c, weight, sum -> sum + c * weight end)
    end

    defp contrast(a, b) do
      [low, high] = Enum.sort([luminance(a), luminance(b)])
      (high + 0.05) / (low + 0.05)
    end

    test "of text on what is behind it have a contrast of 4.5, dark and light; of signs 3" do
      css = File.read!(Path.join(@css, "tokens.css"))

      tokens =
        for [_all, name, light, dark] <- Regex.scan(~r/--([a-z-]+): light-dark\((#\w{6}), (#\w{6})\)/, css),
            into: %{"on-bad" => {"#ffffff", "#ffffff"}},
            do: {name, {light, dark}}

      text =
        for fore <- ~w(text muted accent ok warn bad info),
            back <- ~w(bg surface raised),
            do: {fore, back, 4.5}

      soft = for kind <- ~w(ok warn bad info), do: {kind, "#{kind}-soft", 4.5}
      soft_text = for kind <- ~w(ok warn bad info accent), do: {"text", "#{kind}-soft", 4.5}
      filled = [{"on-accent", "accent", 4.5}, {"on-bad", "bad-fill", 4.5}]
      signs = for sign <- ~w(line-strong focus), back <- ~w(bg surface raised), do: {sign, back, 3.0}

      for {fore, back, least} <- text ++ soft ++ soft_text ++ filled ++ signs, theme <- [0, 1] do
        found = contrast(elem(tokens[fore], theme), elem(tokens[back], theme))

        assert found >= least,
               "#{fore} on #{back} (#{Enum.at(~w(light dark), theme)}): #{Float.round(found, 2)}"
      end
    end
  end
end
