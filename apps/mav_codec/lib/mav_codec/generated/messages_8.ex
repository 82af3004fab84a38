defmodule MavCodec.Generated.Messages8 do
  use MavCodec.Definition.Shard, messages: {8, 8}
end
