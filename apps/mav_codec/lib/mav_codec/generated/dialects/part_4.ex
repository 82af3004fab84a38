defmodule MavCodec.Generated.Dialects.Part4 do
  use MavCodec.Definition.Shard, dialects: {4, 4}
end
